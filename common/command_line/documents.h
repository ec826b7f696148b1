// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace CLI {
class App;
}

/// What can be said about a program, or its command line, from its table of options alone: the same table that parses
/// its command line and prints its help, so that none of them can fall behind.
namespace eigencast {

enum class Shell { kBash, kZsh, kFish };
/// "bash", "zsh" or "fish".
std::optional<Shell> shell_from_name(std::string_view name);

/// What is wrong with numbers that a command line gave and CLI11 takes: "nan" lies in no range, and in every one by its
/// comparisons. Empty: nothing. REQUIRES: `app` has parsed.
std::string fault_of_numbers(const CLI::App& app);

/// A completion script for the program of that name: commands, options, the values of options that have a fixed set,
/// files otherwise. What the table hides (an empty group) is left out.
std::string completion_from(const CLI::App& app, Shell shell);

/// The manual page, section 1, as roff.
///   version      "0.1.0"
///   exit_status  a line each: "0 done"
///   examples     a line each, as typed
std::string man_page_from(const CLI::App& app, std::string_view version, std::string_view exit_status,
                          std::string_view examples);

}  // namespace eigencast
