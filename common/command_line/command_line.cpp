// SPDX-License-Identifier: MIT
#include "common/command_line/command_line.h"

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string_view>
#include <type_traits>

#include "common/command_line/option_text.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

constexpr const char* kNegative = " not in range 0 to 1e19";

template <typename Value>
CLI::Option* add_entry(CLI::App& app, const OptionEntry& entry, Value& value) {
  if constexpr (std::is_same_v<Value, bool>) {
    return app.add_flag(entry.names, value, entry.help);
  } else {
    CLI::Option* option = app.add_option(entry.names, value, entry.help);
    if constexpr (std::is_arithmetic_v<Value>) {
      if (const auto* range = std::get_if<OptionEntry::Range>(&entry.allowed))
        option->check(CLI::Range(static_cast<Value>(range->low), static_cast<Value>(range->high)));
    }
    if constexpr (std::is_unsigned_v<Value>)  // CLI11 takes -1 for the largest of all.
      option->check([](const std::string& text) { return text.starts_with('-') ? "Value " + text + kNegative : ""; });
    if (const auto* choices = std::get_if<std::vector<std::string>>(&entry.allowed))
      option->check(CLI::IsMember(*choices));
    return entry.shows_default ? option->capture_default_str() : option;
  }
}

/// "0 to 1", "at least 0.1": limits that nobody reaches are not limits.
std::string words_from_limits(double low, double high) {
  constexpr double kNoLimit = 1e6;
  if (high < kNoLimit) return formatted("%g to %g", low, high);
  return low > 0 ? formatted("at least %g", low) : std::string();
}

/// Likewise, from CLI11's "FLOAT in [0 - 1]".
std::string words_from_range(const std::string& type) {
  double low = 0, high = 0;
  const std::size_t at = type.find(" in [");
  if (at == std::string::npos || std::sscanf(type.c_str() + at, " in [%lf - %lf]", &low, &high) != 2) return {};
  return words_from_limits(low, high);
}

/// What CLI11 says of numbers and words that it does not take, in plain words: "OPTION: Value 7 not in range 0 to 1".
std::string words_from_failure(const std::string& failure) {
  const auto between = [&](std::string_view begin, std::string_view end) -> std::optional<std::string> {
    const std::size_t from = failure.find(begin), to = failure.rfind(end);
    if (from == std::string::npos || to == std::string::npos || to < from + begin.size()) return std::nullopt;
    return failure.substr(from + begin.size(), to - from - begin.size());
  };
  const std::string option = failure.substr(0, failure.find(':'));
  double low = 0, high = 0;
  if (const auto value = between(": Value ", " not in range ")) {
    const char* range = failure.c_str() + failure.rfind(" not in range ");
    if (std::sscanf(range, " not in range %lf to %lf", &low, &high) != 2) return failure;
    const std::string limits = words_from_limits(low, high);
    return option + ": " + *value + " is not " + (limits.empty() ? formatted("at least %g", low) : limits);
  }
  if (const auto value = between(": ", " not in {"); value && failure.ends_with('}')) {
    std::string choices = failure.substr(failure.rfind(" not in {") + 9);
    choices.pop_back();
    for (std::size_t at = 0; (at = choices.find(',', at)) != std::string::npos; at += 2) choices.insert(at + 1, " ");
    return option + ": " + *value + " is none of " + choices;
  }
  if (const auto kind = between(": 1 required ", " missing"))
    return option + (kind->starts_with("TEXT") ? ": a word is missing" : ": a number is missing");
  unsigned most = 0, count = 0;
  const std::string again = failure.substr(std::min(failure.size(), option.size()));
  if (std::sscanf(again.c_str(), ": At Most %u required but received %u", &most, &count) == 2)
    return option + formatted(": given %u times; give it ", count) + (most == 1 ? "once" : formatted("%u times", most));
  if (const auto unknown = between("not expected: ", "")) return *unknown + " was not expected";
  return failure;
}

/// CLI11's own leaves out the commands below a command, and gives types, limits and defaults as programs write them.
class NestedHelp final : public CLI::Formatter {
 public:
  std::string make_option_opts(const CLI::Option* option) const override {
    if (!option->get_option_text().empty()) return " " + option->get_option_text();
    const std::string type = option->get_type_name(), kind = type.substr(0, type.find(':'));
    if (option->get_type_size() == 0) return {};
    std::string text = kind == "FLOAT" || kind == "INT" || kind == "UINT" ? " NUMBER" : kind.empty() ? "" : " " + kind;
    if (option->get_expected_max() == CLI::detail::expected_max_vector_size) text += " ...";
    return text;
  }

  std::string make_option_desc(const CLI::Option* option) const override {
    const std::string& description = option->get_description();
    std::string text;
    const auto add = [&text](const std::string& part) {
      text += part.empty() ? "" : (text.empty() ? "" : "; ") + part;
    };
    if (option->get_type_size() != 0) {
      const std::vector<std::string> choices = choices_of(*option);
      if (!names_all(description, choices)) add(joined(choices, ", "));
      add(words_from_range(option->get_type_name()));
      if (option->get_required()) add("needed");
      if (!option->get_default_str().empty()) add("default: " + option->get_default_str());
      if (!option->get_envname().empty()) add("or $" + option->get_envname());
    }
    for (const CLI::Option* other : option->get_needs()) add("with " + other->get_name());
    for (const CLI::Option* other : option->get_excludes()) add("not with " + other->get_name());
    return text.empty() ? description : description + " (" + text + ")";
  }

  std::string make_expanded(const CLI::App* command) const override {
    std::string text = CLI::Formatter::make_expanded(command);
    const CLI::App* above = command->get_parent();
    if (above != nullptr && above->get_footer() != command->get_footer()) text += make_footer(command) + "\n";
    for (const CLI::App* below : command->get_subcommands({}))
      if (!below->get_name().empty()) text += make_expanded(below);
    return text;
  }
};

/// Without positional words, which have no dashes.
std::vector<std::string> names_of(const std::vector<const CLI::Option*>& options) {
  std::vector<std::string> names;
  for (const CLI::Option* option : options) {
    if (option->get_name().starts_with('-')) names.push_back(option->get_name());
  }
  return names;
}

}  // namespace

CommandLine::CommandLine(const std::string& name, const std::string& description, const std::string& version)
    : app_(std::make_unique<CLI::App>(description, name)) {
  add_help_all(*app_);
  app_->set_version_flag("--version", name + " " + version);
}

CommandLine::~CommandLine() = default;

void CommandLine::add(std::span<const OptionEntry> entries, const std::string& group) {
  for (const OptionEntry& entry : entries) {
    CLI::Option* option = std::visit([&](auto* value) { return add_entry(*app_, entry, *value); }, entry.value);
    option->group(group);
    if (entry.environment != nullptr) option->envname(entry.environment);
  }
}

void CommandLine::set_footer(const std::string& text) {
  app_->footer(text);
}

void CommandLine::amend(const char* option, const char* help, const char* environment) {
  app_->get_option(option)->description(help)->envname(environment);
}

std::optional<bool> CommandLine::parse(int argc, const char* const* argv) {
  try {
    app_->parse(argc, argv);
    return std::nullopt;
  } catch (const CLI::ParseError& stop) {
    return app_->exit(stop) == 0;
  }
}

bool CommandLine::has(const char* option) const {
  return app_->count(option) > 0;
}

void add_help_all(CLI::App& app) {
  app.formatter(std::make_shared<NestedHelp>());
  app.failure_message([](const CLI::App* of, const CLI::Error& error) {
    std::string command = of->get_name();
    for (const CLI::App* given : of->get_subcommands()) command += " " + given->get_name();
    return of->get_name() + ": " + words_from_failure(error.what()) + "\nTry " + command + " --help\n";
  });
  app.set_help_all_flag("--help-all", "print this message and that of every command");
}

std::vector<std::string> CommandLine::given() const {
  return given_in(*app_);
}

std::vector<std::string> CommandLine::names() const {
  return names_of(std::as_const(*app_).get_options());
}

std::vector<std::string> given_in(const CLI::App& app) {
  return names_of({app.parse_order().begin(), app.parse_order().end()});
}

CLI::Option* add_credential_options(CLI::App& app, Credentials& credentials) {
  CLI::Option* token = app.add_option("--token", credentials.token, "token for the broker, or @FILE that holds it");
  token->group(kCredentialsGroup);
  app.add_option("--ca", credentials.ca_file, "PEM file of the authorities trusted for wss:// (default: the system's)")
      ->group(kCredentialsGroup);
  app.add_option("--cert", credentials.certificate_file, "PEM file of a certificate for brokers that ask for one")
      ->group(kCredentialsGroup);
  app.add_option("--key", credentials.key_file, "PEM file of its private key")->group(kCredentialsGroup);
  app.add_flag("--insecure", credentials.insecure, "do not check the broker's certificate: for trying out only")
      ->group(kCredentialsGroup);
  return token;
}

CLI::Validator output_path(Result<void> (*check)(const std::string& path)) {
  return CLI::Validator(
      [check](std::string& path) -> std::string {
        const auto usable = path == "-" ? Result<void>() : check(path);
        return usable ? std::string() : usable.error().message;
      },
      "");
}

std::string fault_of_numbers(const CLI::App& app) {
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_type_name().rfind("FLOAT", 0) != 0) continue;
    for (const std::string& text : option->results()) {
      if (std::isnan(std::strtod(text.c_str(), nullptr))) return option->get_name() + ": " + text + " is not a number";
    }
  }
  for (const CLI::App* command : app.get_subcommands()) {
    if (std::string fault = fault_of_numbers(*command); !fault.empty()) return fault;
  }
  return {};
}

}  // namespace eigencast
