// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace CLI {
class App;
}

namespace eigencast {

/// A completion script for the program of that name, made from the table of options that parses its command line:
/// commands, options, the values of options that have a fixed set, files otherwise. Leaves out what the table hides (an
/// empty group).
///   shell  "bash" or "zsh"; nothing for others
std::optional<std::string> completion_script(const CLI::App& app, std::string_view shell);

}  // namespace eigencast
