// SPDX-License-Identifier: MIT
#include <algorithm>

#include "common/command_line/documents.h"
#include "common/command_line/option_table.h"

namespace eigencast {
namespace {

std::string joined(const std::vector<std::string>& words, const char* between) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : between) + word;
  return text;
}

/// The names of the commands right below one.
std::vector<std::string> children_of(const std::vector<CommandRow>& rows, const std::vector<std::string>& path) {
  std::vector<std::string> names;
  for (const CommandRow& row : rows) {
    const bool below = row.path.size() == path.size() + 1 && std::equal(path.begin(), path.end(), row.path.begin());
    if (below) names.push_back(row.path.back());
  }
  return names;
}

std::string option_names(const CommandRow& row) {
  std::vector<std::string> names;
  for (const OptionRow& option : row.options) names.insert(names.end(), option.names.begin(), option.names.end());
  return joined(names, " ");
}

std::string identifier_from(std::string name) {
  std::replace(name.begin(), name.end(), '-', '_');
  return "_" + name;
}

// In single quotes of any of the shells.
std::string in_quotes(const std::string& text) {
  std::string result = "'";
  for (const char c : text) {
    if (c == '\'') {
      result += "'\\''";
    } else {
      result += c;
    }
  }
  return result + "'";
}

/// A statement of bash that takes the lines of a compgen, each one completion.
std::string bash_replies(const std::string& compgen) {
  return "mapfile -t COMPREPLY < <(compgen " + compgen + " -- \"$current\")";
}

std::string bash_from(const std::string& program, const std::vector<CommandRow>& rows) {
  const std::string function = identifier_from(program);
  std::string text =
      "# bash completion for " + program + ", made from its table of options\n" + function + "() {\n" +
      "  local current=\"${COMP_WORDS[COMP_CWORD]}\" previous=\"${COMP_WORDS[COMP_CWORD-1]}\" path=\"\" word\n"
      // --option=value are three words.
      "  if [[ $current == = ]]; then current=\"\"; elif [[ $previous == = ]]; then "
      "previous=\"${COMP_WORDS[COMP_CWORD-2]}\"; fi\n"
      "  for word in \"${COMP_WORDS[@]:1:COMP_CWORD-1}\"; do\n    case \"$path/$word\" in\n";
  for (const CommandRow& row : rows) {
    if (!row.path.empty())
      text += "      " + in_quotes("/" + joined(row.path, "/")) + ") path=" + in_quotes("/" + joined(row.path, "/")) +
              ";;\n";
  }
  text += "    esac\n  done\n  case \"$path $previous\" in\n";
  for (const CommandRow& row : rows) {
    const std::string path = row.path.empty() ? "" : "/" + joined(row.path, "/");
    for (const OptionRow& option : row.options) {
      if (!option.takes_value()) continue;
      const std::string action =
          bash_replies(option.choices.empty() ? "-f" : "-W " + in_quotes(joined(option.choices, " ")));
      for (const std::string& name : option.names)
        text += "    " + in_quotes(path + " " + name) + ") " + action + "; return;;\n";
    }
  }
  text += "  esac\n  case \"$path\" in\n";
  for (const CommandRow& row : rows) {
    const std::string path = row.path.empty() ? "" : "/" + joined(row.path, "/");
    std::vector<std::string> words = children_of(rows, row.path);
    for (const OptionRow& argument : row.arguments)
      words.insert(words.end(), argument.choices.begin(), argument.choices.end());
    text += "    " + in_quotes(path) + ")\n      if [[ \"$current\" == -* ]]; then " +
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

std::string zsh_values(const OptionRow& option) {
  return zsh_text(option.argument) + ":" +
         (option.choices.empty() ? "_files" : "(" + joined(option.choices, " ") + ")");
}

void append_zsh_function(const std::string& name, const CommandRow& row, const std::vector<CommandRow>& rows,
                         std::string& text) {
  const std::vector<std::string> children = children_of(rows, row.path);
  text += name + "() {\n  local state line\n  typeset -A opt_args\n  _arguments -C \\\n";
  for (const OptionRow& option : row.options) {
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
  // One may stand for several; of several each has its place.
  for (std::size_t i = 0; i < row.arguments.size(); ++i) {
    const std::string place = row.arguments.size() == 1 ? "*" : std::to_string(i + 1);
    text += "    " + in_quotes(place + ":" + zsh_values(row.arguments[i])) + " \\\n";
  }
  if (children.empty()) {
    text += "    && return\n}\n";
    return;
  }
  text += "    '1: :->command' '*:: :->rest' && return\n  case $state in\n    command)\n      local -a commands=(\n";
  for (const CommandRow& child : rows) {
    const bool below =
        child.path.size() == row.path.size() + 1 && std::equal(row.path.begin(), row.path.end(), child.path.begin());
    if (below) text += "        " + in_quotes(zsh_text(child.path.back()) + ":" + zsh_text(child.description)) + "\n";
  }
  text += "      )\n      _describe command commands;;\n    rest)\n      case $words[1] in\n";
  for (const std::string& child : children) text += "        " + child + ") " + name + "_" + child + ";;\n";
  text += "      esac;;\n  esac\n}\n";
}

std::string zsh_from(const std::string& program, const std::vector<CommandRow>& rows) {
  std::string text = "#compdef " + program + "\n# made from the program's table of options\n";
  for (const CommandRow& row : rows) {
    append_zsh_function(identifier_from(program) + (row.path.empty() ? "" : "_" + joined(row.path, "_")), row, rows,
                        text);
  }
  return text + identifier_from(program) + " \"$@\"\n";
}

std::string fish_from(const std::string& program, const std::vector<CommandRow>& rows) {
  const std::string start = "complete -c " + program;
  std::string text = "# fish completion for " + program + ", made from its table of options\n";
  for (const CommandRow& row : rows) {
    const std::vector<std::string> children = children_of(rows, row.path);
    std::string condition = row.path.empty() ? "__fish_use_subcommand" : "";
    for (const std::string& word : row.path)
      condition += (condition.empty() ? "" : "; and ") + ("__fish_seen_subcommand_from " + word);
    for (const std::string& child : children) {
      if (!row.path.empty()) condition += "; and not __fish_seen_subcommand_from " + joined(children, " ");
      const auto at = std::find_if(rows.begin(), rows.end(), [&](const CommandRow& r) {
        return r.path.size() == row.path.size() + 1 && r.path.back() == child &&
               std::equal(row.path.begin(), row.path.end(), r.path.begin());
      });
      text += start + " -f -n " + in_quotes(condition) + " -a " + child + " -d " + in_quotes(at->description) + "\n";
    }
    for (const OptionRow& option : row.options) {
      text += start + (row.path.empty() ? "" : " -n " + in_quotes(condition));
      for (const std::string& name : option.names)
        text += name[1] == '-' ? " -l " + name.substr(2) : " -s " + name.substr(1);
      if (option.takes_value())
        text += option.choices.empty() ? " -r" : " -x -a " + in_quotes(joined(option.choices, " "));
      text += " -d " + in_quotes(option.description) + "\n";
    }
    for (const OptionRow& argument : row.arguments) {
      if (!argument.choices.empty())
        text += start + " -f -n " + in_quotes(condition) + " -a " + in_quotes(joined(argument.choices, " ")) + "\n";
    }
  }
  return text;
}

}  // namespace

std::optional<Shell> shell_from_name(std::string_view name) {
  if (name == "bash") return Shell::kBash;
  if (name == "zsh") return Shell::kZsh;
  if (name == "fish") return Shell::kFish;
  return std::nullopt;
}

std::string completion_from(const CLI::App& app, Shell shell) {
  const OptionTable table = table_from(app);
  switch (shell) {
    case Shell::kBash:
      return bash_from(table.program, table.commands);
    case Shell::kZsh:
      return zsh_from(table.program, table.commands);
    case Shell::kFish:
      return fish_from(table.program, table.commands);
  }
  return {};
}

}  // namespace eigencast
