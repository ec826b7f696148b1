// SPDX-License-Identifier: MIT
#include "common/command_line/option_table.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "common/command_line/documents.h"

namespace eigencast {
namespace {

// CLI11 states the members of a set in the type: "TEXT:{augmented,harmonic}".
std::vector<std::string> choices_in(const std::string& type) {
  std::vector<std::string> choices;
  const std::size_t open = type.find('{');
  const std::size_t close = type.find('}');
  if (open == std::string::npos || close == std::string::npos) return choices;
  std::string choice;
  for (std::size_t i = open + 1; i <= close; ++i) {
    if (type[i] != ',' && i != close) {
      choice += type[i];
      continue;
    }
    choices.push_back(choice);
    choice.clear();
  }
  return choices;
}

OptionRow row_from(const CLI::Option& option) {
  OptionRow row;
  for (const std::string& name : option.get_snames()) row.names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) row.names.push_back("--" + name);
  const std::string type = option.get_type_name();
  row.choices = choices_in(type);
  if (option.get_items_expected_max() > 0 && option.get_type_size() != 0) {
    row.argument = row.names.empty() ? option.get_name() : type.substr(0, type.find_first_of(":{ "));
    if (row.argument.empty()) row.argument = "VALUE";
  }
  row.description = option.get_description();
  row.environment = option.get_envname();
  row.required = option.get_required();
  const bool are_told = std::all_of(row.choices.begin(), row.choices.end(), [&](const std::string& choice) {
    return row.description.find(choice) != std::string::npos;
  });
  if (!are_told) {
    row.description += ": ";
    for (std::size_t i = 0; i < row.choices.size(); ++i) row.description += (i > 0 ? ", " : "") + row.choices[i];
  }
  if (!option.get_default_str().empty()) row.description += " (default: " + option.get_default_str() + ")";
  return row;
}

std::vector<const CLI::App*> commands_below(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App*) { return true; });
}

/// Those of its groups, too, which CLI11 holds as commands without a name.
void add_options(const CLI::App& app, CommandRow& row) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;
    OptionRow mine = row_from(*option);
    (mine.names.empty() ? row.arguments : row.options).push_back(std::move(mine));
  }
  for (const CLI::App* group : commands_below(app)) {
    if (group->get_name().empty()) add_options(*group, row);
  }
}

void add_commands(const CLI::App& app, std::vector<std::string> path, std::vector<CommandRow>& rows) {
  CommandRow row;
  row.path = path;
  row.description = app.get_description();
  add_options(app, row);
  rows.push_back(std::move(row));
  for (const CLI::App* command : commands_below(app)) {
    if (command->get_name().empty() || command->get_group().empty()) continue;
    std::vector<std::string> below = path;
    below.push_back(command->get_name());
    add_commands(*command, std::move(below), rows);
  }
}

}  // namespace

OptionTable table_from(const CLI::App& app) {
  OptionTable table{app.get_name(), app.get_require_subcommand_min() > 0, {}};
  add_commands(app, {}, table.commands);
  return table;
}

std::string fault_of_numbers(const CLI::App& app) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_type_name().rfind("FLOAT", 0) != 0) continue;
    for (const std::string& text : option->results()) {
      if (std::isnan(std::strtod(text.c_str(), nullptr))) return option->get_name() + ": " + text + " is no number";
    }
  }
  for (const CLI::App* command : app.get_subcommands()) {
    if (std::string fault = fault_of_numbers(*command); !fault.empty()) return fault;
  }
  return {};
}

}  // namespace eigencast
