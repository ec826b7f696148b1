// SPDX-License-Identifier: MIT
#pragma once

#include <string>

namespace eigencast {

/// As printf, of any length.
[[gnu::format(printf, 1, 2)]] std::string formatted(const char* format, ...);

}  // namespace eigencast
