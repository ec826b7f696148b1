// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "common/core/result.h"
#include "common/net/url.h"

namespace CLI {
class App;
class Option;
class Validator;
}  // namespace CLI

namespace eigencast {

struct OptionEntry {
  struct Range {
    double low = 0, high = 0;
  };
  const char* names;  ///< "--lod", "-v,--verbose"; without dashes: positional.
  std::variant<bool*, int*, double*, std::uint64_t*, std::string*, std::vector<std::string>*> value;  ///< bool: a flag.
  const char* help;
  std::variant<std::monostate, Range, std::vector<std::string>> allowed = {};  ///< By default anything.
  bool shows_default = false;
  const char* environment = nullptr;  ///< The variable that is read where the option is not given.
};

/// --help or a usage error have been printed.
struct ExitNow {
  int code = 0;
};

/// A program's command line. Its source alone pays for CLI11's header, and for one instance of its templates.
class CommandLine {
 public:
  CommandLine(const std::string& name, const std::string& description, const std::string& version);
  ~CommandLine();

  /// group: heads them in the help.
  void add(std::span<const OptionEntry> entries, const std::string& group = "Options");
  void set_footer(const std::string& text);
  /// Says more about an option that is there, or names its environment variable.
  void amend(const char* option, const char* help, const char* environment);
  /// Nothing, if the program is to go on; else help or an error has been printed. True: it was help.
  std::optional<bool> parse(int argc, const char* const* argv);
  /// Whether the option was given. REQUIRES: parse().
  bool has(const char* option) const;
  /// The options that the command line itself gave, which the environment did not. REQUIRES: parse().
  std::vector<std::string> given() const;
  std::vector<std::string> names() const;  ///< Of all options.
  CLI::App& app() { return *app_; }
  const CLI::App& app() const { return *app_; }

 private:
  std::unique_ptr<CLI::App> app_;
};

// What several programs have, alike in name and meaning.

/// --token, --ca, --cert, --key and --insecure. Gives --token, for what a program says of it beyond that.
CLI::Option* add_credential_options(CLI::App& app, Credentials& credentials);
inline constexpr const char* kCredentialsGroup = "Who you are";

/// Help in words: what a value is, its limits, its default. --help-all: the help of every command, nested ones too;
/// manual pages are made from it. Call before adding commands.
void add_help_all(CLI::App& app);

/// The options that the command line itself gave to a command, which the environment did not.
/// REQUIRES: `app` has parsed.
std::vector<std::string> given_in(const CLI::App& app);

/// What is wrong with numbers that a command line gave and CLI11 takes: "nan" lies in no range, and in every one by its
/// comparisons. Empty: nothing. REQUIRES: `app` has parsed.
std::string fault_of_numbers(const CLI::App& app);

/// For files and folders of results: errors are reported before the work. "-" is standard output.
///   check  check_output_file or check_output_folder
CLI::Validator output_path(Result<void> (*check)(const std::string& path));

/// A completion script for the program of that name: commands, options, the values of options that have a fixed set,
/// files otherwise. Leaves out what the table of options hides (an empty group).
///   shell  "bash" or "zsh"; nothing for others
std::optional<std::string> completion_script(const CLI::App& app, std::string_view shell);

}  // namespace eigencast
