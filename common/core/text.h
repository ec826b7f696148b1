// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

namespace eigencast {

/// As printf, of any length.
[[gnu::format(printf, 1, 2)]] std::string formatted(const char* format, ...);

/// Without the blanks, tabs and line ends around it.
std::string_view trimmed(std::string_view text);

}  // namespace eigencast
