// SPDX-License-Identifier: MIT
#include "broker/config/show.h"

#include <algorithm>
#include <string_view>

#include "common/core/user_info.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kWidth = 118;

constexpr std::string_view kHead =
    "Eigencast broker: every setting, with its default. This file is the manual of the settings; it is made by "
    "eigencast-broker --default-config.";
constexpr std::string_view kPrecedence =
    "A flag (--limits-max-streams 16; those of [server] without the section: --listen) wins over the environment "
    "(EIGENCAST_LIMITS__MAX_STREAMS=16), that over this file, that over the defaults. Lists are separated by commas "
    "there. Unknown keys are refused. Try a file with --check-config, see what counts with --show-config. SIGHUP reads "
    "it again: all of it is applied, or, where something is wrong with it, nothing.";

/// `text` as comment lines, wrapped at blanks.
std::string comment(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    std::size_t length = text.size();
    if (length > kWidth) {
      length = text.rfind(' ', kWidth);
      if (length == std::string_view::npos) length = std::min(text.find(' '), text.size());
    }
    out += "# " + std::string(text.substr(0, length)) + "\n";
    text.remove_prefix(std::min(length + 1, text.size()));
  }
  return out;
}

std::string rules_of(const Setting& setting) {
  std::string rules;
  for (const auto choice : setting.choices) rules += (rules.empty() ? "one of " : ", ") + std::string(choice);
  if (setting.max > setting.min) {
    rules += std::to_string(setting.min) + " to " + std::to_string(setting.max);
    rules += setting.unit.empty() ? "" : " " + std::string(setting.unit);
  }
  return rules + (rules.empty() ? "" : "; ") + (setting.live ? "reloadable" : "needs a restart");
}

std::string shown(const Config& config, const Setting& setting) {
  SettingValue value = value_of(config, setting);
  if (setting.path() == "backbone.servers") {
    for (std::string& server : std::get<std::vector<std::string>>(value)) server = without_user_info(server);
  }
  if (!setting.secret) return toml_of(value);
  return std::get<std::string>(value).empty() ? "\"\"" : "\"(set)\"";
}

std::string line_of(const Config& config, const Setting& setting) {
  return std::string(setting.name) + " = " + shown(config, setting);
}

}  // namespace

std::string default_file() {
  std::string out = comment(kHead) + "#\n" + comment(kPrecedence);
  const Config defaults;
  std::string_view section;
  for (const Setting& setting : settings()) {
    if (setting.section != section) {
      section = setting.section;
      out += "\n" + comment(section_doc(section)) + "[" + std::string(section) + "]\n";
    }
    out += comment(setting.doc) + "#   " + rules_of(setting) + "\n" + line_of(defaults, setting) + "\n";
  }
  return out;
}

std::string shown_config(const LoadedConfig& loaded) {
  std::string out;
  std::string_view section;
  for (const Setting& setting : settings()) {
    if (setting.section != section) {
      out += (section.empty() ? "[" : "\n[") + std::string(setting.section) + "]\n";
      section = setting.section;
    }
    std::string line = line_of(loaded.config, setting);
    line.resize(std::max<std::size_t>(line.size(), 44), ' ');
    const auto origin = loaded.origins.find(setting.path());
    out += line + " # " + (origin == loaded.origins.end() ? "default" : origin->second) + "\n";
  }
  return out;
}

std::vector<ConfigChange> changes_between(const Config& before, const Config& after) {
  std::vector<ConfigChange> changes;
  for (const Setting& setting : settings()) {
    if (value_of(before, setting) == value_of(after, setting)) continue;
    changes.push_back({setting.path(), shown(before, setting), shown(after, setting), setting.live});
  }
  return changes;
}

Config reloaded(const Config& running, const Config& wanted) {
  Config merged = running;
  for (const Setting& setting : settings()) {
    if (!setting.live) continue;
    (void)set_config(merged, setting, value_of(wanted, setting));  // Checked when `wanted` was read.
  }
  return merged;
}

}  // namespace eigencast::broker
