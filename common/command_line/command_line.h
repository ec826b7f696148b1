// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace CLI {
class App;
}

namespace eigencast {

/// One option of a program, as an entry of a table.
struct OptionEntry {
  struct Range {
    double low = 0, high = 0;
  };
  const char* names;  ///< "--lod", "-v,--verbose"; without dashes: positional.
  std::variant<bool*, int*, double*, std::uint64_t*, std::string*, std::vector<std::string>*> value;  ///< bool: a flag.
  const char* help;
  std::variant<std::monostate, Range, std::vector<std::string>> allowed = {};  ///< By default anything.
  bool shows_default = false;
  const char* environment = nullptr;  ///< The variable that stands in where the option is not given.
};

/// A program's command line. Its source alone pays for CLI11's header, and for one instance of its templates.
class CommandLine {
 public:
  CommandLine(const std::string& name, const std::string& description, const std::string& version);
  ~CommandLine();

  void add(std::span<const OptionEntry> entries);
  void set_footer(const std::string& text);
  /// Says more about an option that is there, or names its environment variable.
  void amend(const char* option, const char* help, const char* environment);
  /// Nothing, if the program is to go on; else help or an error has been printed. True: it was help.
  std::optional<bool> parse(int argc, const char* const* argv);
  /// Whether the option was given. REQUIRES: parse().
  bool has(const char* option) const;
  CLI::App& app() { return *app_; }
  const CLI::App& app() const { return *app_; }

 private:
  std::unique_ptr<CLI::App> app_;
};

}  // namespace eigencast
