// SPDX-License-Identifier: MIT
#include "common/command_line/command_line.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <vector>

#include "common/command_line/option_text.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

struct ListedOption {
  std::vector<std::string> names;    ///< "-o", "--out"
  std::string argument;              ///< "FLOAT", "NAME"; empty: a flag.
  std::vector<std::string> choices;  ///< All values it takes, where they are a fixed set.
  std::string description;           ///< With its default, if any.
  bool takes_value() const { return !argument.empty(); }
};

/// A command with its options. The program itself is the first, with an empty path.
struct ListedCommand {
  std::vector<std::string> path;  ///< {"context", "add"}
  std::string description;
  std::vector<ListedOption> options, arguments;
  std::string slashed() const { return path.empty() ? "" : "/" + joined(path, "/"); }
};

ListedOption row_from(const CLI::Option& option) {
  ListedOption row;
  for (const std::string& name : option.get_snames()) row.names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) row.names.push_back("--" + name);
  const std::string type = option.get_type_name();
  row.choices = choices_of(option);
  if (option.get_items_expected_max() > 0 && option.get_type_size() != 0) {
    row.argument = row.names.empty() ? option.get_name() : type.substr(0, type.find_first_of(":{ "));
    if (row.argument.empty()) row.argument = "VALUE";
  }
  row.description = option.get_description();
  if (!names_all(row.description, row.choices)) row.description += ": " + joined(row.choices, ", ");
  if (!option.get_default_str().empty()) row.description += " (default: " + option.get_default_str() + ")";
  return row;
}

std::vector<const CLI::App*> commands_below(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App*) { return true; });
}

/// Those of its groups, too, which CLI11 holds as commands without a name.
void add_options(const CLI::App& app, ListedCommand& row) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;
    ListedOption mine = row_from(*option);
    (mine.names.empty() ? row.arguments : row.options).push_back(std::move(mine));
  }
  for (const CLI::App* group : commands_below(app)) {
    if (group->get_name().empty()) add_options(*group, row);
  }
}

void add_commands(const CLI::App& app, std::vector<std::string> path, std::vector<ListedCommand>& rows) {
  ListedCommand row;
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

bool is_right_below(const ListedCommand& child, const ListedCommand& row) {
  return child.path.size() == row.path.size() + 1 && std::equal(row.path.begin(), row.path.end(), child.path.begin());
}

std::vector<std::string> children_of(const std::vector<ListedCommand>& rows, const ListedCommand& row) {
  std::vector<std::string> names;
  for (const ListedCommand& child : rows)
    if (is_right_below(child, row)) names.push_back(child.path.back());
  return names;
}

std::string option_names(const ListedCommand& row) {
  std::vector<std::string> names;
  for (const ListedOption& option : row.options) names.insert(names.end(), option.names.begin(), option.names.end());
  return joined(names, " ");
}

std::string identifier_from(std::string name) {
  std::replace(name.begin(), name.end(), '-', '_');
  return "_" + name;
}

std::string in_quotes(const std::string& text) {
  std::string result = "'";
  for (const char c : text) result += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return result + "'";
}

/// A statement of bash that takes the lines of a compgen, each one completion.
std::string bash_replies(const std::string& compgen) {
  return "mapfile -t COMPREPLY < <(compgen " + compgen + " -- \"$current\")";
}

std::string bash_from(const std::string& program, const std::vector<ListedCommand>& rows) {
  const std::string function = identifier_from(program);
  std::string text =
      "# bash completion for " + program + ", made from its table of options\n" + function + "() {\n" +
      "  local current=\"${COMP_WORDS[COMP_CWORD]}\" previous=\"${COMP_WORDS[COMP_CWORD-1]}\" path=\"\" word\n"
      // --option=value are three words.
      "  if [[ $current == = ]]; then current=\"\"; elif [[ $previous == = ]]; then "
      "previous=\"${COMP_WORDS[COMP_CWORD-2]}\"; fi\n"
      "  for word in \"${COMP_WORDS[@]:1:COMP_CWORD-1}\"; do\n    case \"$path/$word\" in\n";
  for (const ListedCommand& row : rows) {
    if (!row.path.empty()) text += "      " + in_quotes(row.slashed()) + ") path=" + in_quotes(row.slashed()) + ";;\n";
  }
  text += "    esac\n  done\n  case \"$path $previous\" in\n";
  for (const ListedCommand& row : rows) {
    for (const ListedOption& option : row.options) {
      if (!option.takes_value()) continue;
      const std::string action =
          bash_replies(option.choices.empty() ? "-f" : "-W " + in_quotes(joined(option.choices, " ")));
      for (const std::string& name : option.names)
        text += "    " + in_quotes(row.slashed() + " " + name) + ") " + action + "; return;;\n";
    }
  }
  text += "  esac\n  case \"$path\" in\n";
  for (const ListedCommand& row : rows) {
    std::vector<std::string> words = children_of(rows, row);
    for (const ListedOption& argument : row.arguments)
      words.insert(words.end(), argument.choices.begin(), argument.choices.end());
    text += "    " + in_quotes(row.slashed()) + ")\n      if [[ \"$current\" == -* ]]; then " +
            bash_replies("-W " + in_quotes(option_names(row))) + "; else " +
            bash_replies(words.empty() ? "-f" : "-W " + in_quotes(joined(words, " "))) + "; fi;;\n";
  }
  return text + "  esac\n}\ncomplete -o filenames -F " + function + " " + program + "\n";
}

// A description in a specification of _arguments or _describe.
std::string zsh_text(const std::string& text) {
  std::string result;
  for (const char c : text) {
    if (c == '[' || c == ']' || c == ':' || c == '\\') result += '\\';
    result += c;
  }
  return result;
}

std::string zsh_values(const ListedOption& option) {
  return zsh_text(option.argument) + ":" +
         (option.choices.empty() ? "_files" : "(" + joined(option.choices, " ") + ")");
}

void append_zsh_function(const std::string& name, const ListedCommand& row, const std::vector<ListedCommand>& rows,
                         std::string& text) {
  const std::vector<std::string> children = children_of(rows, row);
  text += name + "() {\n  local state line\n  typeset -A opt_args\n  _arguments -C \\\n";
  for (const ListedOption& option : row.options) {
    const std::string others = option.names.size() > 1 ? "(" + joined(option.names, " ") + ")" : "";
    for (const std::string& each : option.names) {
      text +=
          "    " +
          in_quotes(others + each +
                    (!option.takes_value() ? ""
                     : each[1] == '-'      ? "="
                                           : "+") +
                    "[" + zsh_text(option.description) + "]" + (option.takes_value() ? ":" + zsh_values(option) : "")) +
          " \\\n";
    }
  }
  // A single one takes all words; of several each has its number.
  for (std::size_t i = 0; i < row.arguments.size(); ++i) {
    const std::string position = row.arguments.size() == 1 ? "*" : std::to_string(i + 1);
    text += "    " + in_quotes(position + ":" + zsh_values(row.arguments[i])) + " \\\n";
  }
  if (children.empty()) {
    text += "    && return\n}\n";
    return;
  }
  text += "    '1: :->command' '*:: :->rest' && return\n  case $state in\n    command)\n      local -a commands=(\n";
  for (const ListedCommand& child : rows) {
    if (is_right_below(child, row))
      text += "        " + in_quotes(zsh_text(child.path.back()) + ":" + zsh_text(child.description)) + "\n";
  }
  text += "      )\n      _describe command commands;;\n    rest)\n      case $words[1] in\n";
  for (const std::string& child : children) text += "        " + child + ") " + name + "_" + child + ";;\n";
  text += "      esac;;\n  esac\n}\n";
}

std::string zsh_from(const std::string& program, const std::vector<ListedCommand>& rows) {
  std::string text = "#compdef " + program + "\n# made from the program's table of options\n";
  for (const ListedCommand& row : rows) {
    append_zsh_function(identifier_from(program) + (row.path.empty() ? "" : "_" + joined(row.path, "_")), row, rows,
                        text);
  }
  return text + identifier_from(program) + " \"$@\"\n";
}

}  // namespace

std::string joined(const std::vector<std::string>& words, const char* between) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : between) + word;
  return text;
}

// CLI11 states the members of a set in the type: "TEXT:{augmented,harmonic}".
std::vector<std::string> choices_of(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t open = type.find('{'), close = type.find('}');
  if (open == std::string::npos || close == std::string::npos) return {};
  const auto choices = split(std::string_view(type).substr(open + 1, close - open - 1), ',');
  return {choices.begin(), choices.end()};
}

bool names_all(std::string_view description, const std::vector<std::string>& choices) {
  return std::all_of(choices.begin(), choices.end(),
                     [&](const std::string& choice) { return description.find(choice) != std::string_view::npos; });
}

std::optional<std::string> completion_script(const CLI::App& app, std::string_view shell) {
  std::vector<ListedCommand> rows;
  add_commands(app, {}, rows);
  if (shell == "bash") return bash_from(app.get_name(), rows);
  if (shell == "zsh") return zsh_from(app.get_name(), rows);
  return std::nullopt;
}

}  // namespace eigencast
