// SPDX-License-Identifier: MIT
#include "common/command_line/command_line.h"

#include <CLI/CLI.hpp>
#include <type_traits>

#include "common/command_line/shared_options.h"

namespace eigencast {
namespace {

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
    if (const auto* choices = std::get_if<std::vector<std::string>>(&entry.allowed))
      option->check(CLI::IsMember(*choices));
    return entry.shows_default ? option->capture_default_str() : option;
  }
}

}  // namespace

CommandLine::CommandLine(const std::string& name, const std::string& description, const std::string& version)
    : app_(std::make_unique<CLI::App>(description, name)) {
  add_help_all(*app_);
  app_->set_version_flag("--version", name + " " + version);
}

CommandLine::~CommandLine() = default;

void CommandLine::add(std::span<const OptionEntry> entries) {
  for (const OptionEntry& entry : entries) {
    CLI::Option* option = std::visit([&](auto* value) { return add_entry(*app_, entry, *value); }, entry.value);
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

}  // namespace eigencast
