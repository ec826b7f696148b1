// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <string>

namespace eigencast {

/// What a message about a lost peer ends with: "; next try in 400 ms", or nothing when there is none.
inline std::string try_again_in(std::chrono::milliseconds wait) {
  return wait.count() > 0 ? "; next try in " + std::to_string(wait.count()) + " ms" : std::string();
}

}  // namespace eigencast
