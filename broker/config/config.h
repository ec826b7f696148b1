// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

/// Every setting of the broker with its default, config.section.name, as settings.def lists them.
struct Config {
#define SECTION(section, doc) struct {
#define END(section) \
  }                  \
  section;
#define TEXT(name, value, when, doc) std::string name = value;
#define SECRET(name, when, doc) std::string name;
#define CHOICE(name, value, choices, when, doc) std::string name = value;
#define LIST(name, values, when, doc) std::vector<std::string> name = values;
#define FLAG(name, value, when, doc) bool name = value;
#define NUMBER(name, value, min, max, unit, when, doc) std::int64_t name = value;
#define CHOICES(...) \
  { __VA_ARGS__ }
#define DEFAULTS(...) \
  { __VA_ARGS__ }
#include "broker/config/settings.def"
};

struct Setting {
  using Field = std::variant<std::string*, bool*, std::int64_t*, std::vector<std::string>*>;
  std::string_view section;
  std::string_view name;
  Field (*field)(Config&) = nullptr;
  std::string_view doc;
  bool live = false;                      ///< A reload applies it; else it needs a restart.
  bool secret = false;                    ///< Never shown.
  std::int64_t min = 0;                   ///< For numbers.
  std::int64_t max = 0;                   ///< For numbers.
  std::string_view unit;                  ///< For numbers.
  std::vector<std::string_view> choices;  ///< For texts; empty: any.

  std::string path() const { return std::string(section) + "." + std::string(name); }
};

std::span<const Setting> settings();                     ///< In the order of the default file.
const Setting* find_setting(std::string_view path);      ///< Null: unknown.
std::string_view section_doc(std::string_view section);  ///< Empty: unknown.

/// Sets one setting from the text of the environment or a flag.
/// Errors: kInvalidArgument (unknown key, with a suggestion; wrong type; out of range).
Result<void> set_config(Config& config, std::string_view path, std::string_view value);

using SettingValue = std::variant<std::string, bool, std::int64_t, std::vector<std::string>>;
Result<void> set_config(Config& config, const Setting& setting, SettingValue value);
SettingValue value_of(const Config& config, const Setting& setting);
/// Writes the value in TOML syntax: "text", true, 12, ["a", "b"].
std::string toml_of(const SettingValue& value);

/// The name closest to `wanted`; empty: none is close.
std::string closest_to(std::string_view wanted, std::span<const std::string> names);
Error unknown_setting(std::string_view path);  ///< With a suggestion.

/// 1 to 32 letters, digits, '-' and '_': a part of NATS subjects.
bool is_broker_name(std::string_view name);

/// Checks settings that depend on each other.
Result<void> check_config(const Config& config);

// Paths, by the folders that systemd names in the environment (systemd.exec(5)).

/// The folder of assets and recordings: server.data_dir, $STATE_DIRECTORY, $XDG_STATE_HOME/eigencast or
/// ~/.local/state/eigencast.
std::string data_dir_of(const Config& config);
/// The path of a file that a setting names. A relative path is searched in $CREDENTIALS_DIRECTORY, then in
/// $CONFIGURATION_DIRECTORY, then refers to the current folder.
std::string resolved_path(const std::string& path);
/// $CONFIGURATION_DIRECTORY/eigencast.toml; empty: it does not exist.
std::string default_config_file();

/// An "address:port"; IPv6 as "[::1]:7490". Errors: kInvalidArgument.
struct Address {
  std::string host;
  std::uint16_t port = 0;
  bool loopback = false;
};
Result<Address> parse_address(std::string_view text);

}  // namespace eigencast::broker
