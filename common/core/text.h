// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace eigencast {

/// The parts of `text` between separators: one more than it has separators.
std::vector<std::string_view> split(std::string_view text, char separator);

/// As printf, of any length.
[[gnu::format(printf, 1, 2)]] std::string formatted(const char* format, ...);

/// Without the blanks, tabs and line ends around it.
std::string_view trimmed(std::string_view text);

}  // namespace eigencast
