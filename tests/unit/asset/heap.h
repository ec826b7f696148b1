// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>

namespace eigencast {

/// What operator new has given to this program and not got back; and its most since watch_heap().
struct HeapUse {
  std::size_t now = 0, peak = 0;
};
HeapUse heap_use();
void watch_heap();

}  // namespace eigencast
