// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}

/// Private to common/command_line.
namespace eigencast {

/// An option, or a positional argument where it has no names.
struct OptionRow {
  std::vector<std::string> names;    ///< "-o", "--out"
  std::string argument;              ///< "FLOAT", "NAME"; empty: a flag.
  std::vector<std::string> choices;  ///< All values it takes, where they are a fixed set.
  std::string description;           ///< With its default and environment variable, if any.
  std::string environment;
  bool required = false;
  bool takes_value() const { return !argument.empty(); }
};

/// A command with its options, and those below it. The program itself is the first, with an empty path.
struct CommandRow {
  std::vector<std::string> path;  ///< {"context", "add"}
  std::string description;
  std::vector<OptionRow> options;
  std::vector<OptionRow> arguments;
};

/// All that the help shows.
struct OptionTable {
  std::string program;
  bool needs_command = false;        ///< The program does nothing without one.
  std::vector<CommandRow> commands;  ///< Parents before children, in the order of the table.
};
OptionTable table_from(const CLI::App& app);

}  // namespace eigencast
