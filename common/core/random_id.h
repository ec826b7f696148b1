// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>

namespace eigencast {

/// So many hexadecimal digits from the system's source of randomness: a name that nobody else chooses. Thread-safe.
std::string random_id(std::size_t digits = 16);

}  // namespace eigencast
