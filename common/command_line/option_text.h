// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace CLI {
class Option;
}

/// What help and completions say alike about an option. Private to common/command_line.
namespace eigencast {

std::string joined(const std::vector<std::string>& words, const char* between);

/// The values of an option that takes one of a fixed set; else none.
std::vector<std::string> choices_of(const CLI::Option& option);

/// Whether a description names all of an option's values.
bool names_all(std::string_view description, const std::vector<std::string>& choices);

}  // namespace eigencast
