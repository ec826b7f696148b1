// SPDX-License-Identifier: MIT
#include <algorithm>
#include <map>

#include "common/command_line/documents.h"
#include "common/command_line/option_table.h"

namespace eigencast {
namespace {

// Text as roff shows it: no character of it is a command, hyphens can be copied.
std::string roff(std::string_view text) {
  std::string result;
  bool line_start = true;
  for (const char c : text) {
    if (line_start && (c == '.' || c == '\'')) result += "\\&";
    if (c == '\\') {
      result += "\\e";
    } else if (c == '-') {
      result += "\\-";
    } else {
      result += c;
    }
    line_start = c == '\n';
  }
  return result;
}

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; });
  return text;
}

void append_option(const OptionRow& option, std::string& page) {
  page += ".TP\n";
  std::string names;
  for (const std::string& name : option.names) names += (names.empty() ? "" : ", ") + ("\\fB" + roff(name) + "\\fR");
  if (option.takes_value()) names += (names.empty() ? "" : " ") + ("\\fI" + roff(upper(option.argument)) + "\\fR");
  page += names + "\n" + roff(option.description);
  if (!option.environment.empty()) page += " (environment: " + roff(option.environment) + ")";
  if (option.required && !option.names.empty()) page += " (required)";
  page += "\n";
}

void append_verbatim(const char* title, std::string_view text, std::string& page) {
  page += std::string(".SH ") + title + "\n.nf\n" + roff(text);
  if (!text.empty() && text.back() != '\n') page += '\n';
  page += ".fi\n";
}

}  // namespace

std::string man_page_from(const CLI::App& app, std::string_view version, std::string_view exit_status,
                          std::string_view examples) {
  const OptionTable table = table_from(app);
  const std::vector<CommandRow>& rows = table.commands;
  const std::string& name = table.program;
  std::string summary = rows[0].description;
  while (!summary.empty() && summary.back() == '.') summary.pop_back();
  std::string page = ".TH " + upper(roff(name)) + " 1 \"\" \"Eigencast " + std::string(version) +
                     "\" \"User commands\"\n.SH NAME\n" + roff(name) + " \\- " + roff(summary) + "\n.SH SYNOPSIS\n";
  std::map<std::string, std::string> environment;
  std::string commands;
  for (const CommandRow& row : rows) {
    for (const OptionRow& option : row.options) {
      if (!option.environment.empty()) environment[option.environment] = option.description;
    }
    if (row.path.empty()) {
      if (rows.size() == 1 || !table.needs_command) page += "\\fB" + roff(name) + "\\fR [\\fIoptions\\fR]\n.br\n";
      continue;
    }
    std::string title = row.path[0];
    for (std::size_t i = 1; i < row.path.size(); ++i) title += " " + row.path[i];
    page += "\\fB" + roff(name + " " + title) + "\\fR";
    for (const OptionRow& argument : row.arguments) page += " \\fI" + roff(upper(argument.argument)) + "\\fR";
    page += " [\\fIoptions\\fR]\n.br\n";
    commands += ".SS \"" + roff(title) + "\"\n" + roff(row.description) + "\n";
    for (const OptionRow& argument : row.arguments) append_option(argument, commands);
    for (const OptionRow& option : row.options) {
      if (option.names.back() != "--help") append_option(option, commands);
    }
  }
  page += ".SH DESCRIPTION\n" + roff(rows[0].description) + "\n.SH OPTIONS\n";
  for (const OptionRow& option : rows[0].options) append_option(option, page);
  if (!commands.empty()) page += ".SH COMMANDS\n" + commands;
  page += ".SH ENVIRONMENT\n";
  for (const auto& [variable, meaning] : environment)
    page += ".TP\n\\fB" + roff(variable) + "\\fR\n" + roff(meaning) + "\n";
  page += ".TP\n\\fBNO_COLOR\\fR\nif set and not empty, messages have no colours\n";
  append_verbatim("EXIT STATUS", exit_status, page);
  append_verbatim("EXAMPLES", examples, page);
  return page;
}

}  // namespace eigencast
