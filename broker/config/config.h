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

/// Every setting of the broker, with its default: config.section.name. settings.def is the list of them; the file that
/// documents them, deploy/eigencast.toml, is made from it.
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
#define NUMBER(name, value, least, most, unit, when, doc) std::int64_t name = value;
#define CHOICES(...) \
  { __VA_ARGS__ }
#define DEFAULTS(...) \
  { __VA_ARGS__ }
#include "broker/config/settings.def"
};

/// One row of the table of settings: where its value lives and what it may be.
struct Setting {
  using Field = std::variant<std::string*, bool*, std::int64_t*, std::vector<std::string>*>;
  std::string_view section;
  std::string_view name;
  Field (*field)(Config&) = nullptr;
  std::string_view doc;
  bool live = false;                      ///< A reload applies it; otherwise it needs a restart.
  bool secret = false;                    ///< Never shown.
  std::int64_t least = 0;                 ///< Of numbers.
  std::int64_t most = 0;                  ///< Of numbers.
  std::string_view unit;                  ///< Of numbers.
  std::vector<std::string_view> choices;  ///< Of texts; empty = any.

  std::string path() const { return std::string(section) + "." + std::string(name); }
};

/// All settings, in the order of the default file.
std::span<const Setting> settings();
/// Null: there is none.
const Setting* find_setting(std::string_view path);
/// What a section is about; empty: there is no such section.
std::string_view section_doc(std::string_view section);

/// Sets one setting from text, as it comes from the environment or a flag.
/// Errors: kInvalidArgument (unknown key, with a suggestion; wrong type; out of range).
Result<void> set_config(Config& config, std::string_view path, std::string_view value);

/// A value as TOML reads it, whatever it came from: TOML's types without TOML.
using SettingValue = std::variant<std::string, bool, std::int64_t, std::vector<std::string>>;
Result<void> set_config(Config& config, const Setting& setting, SettingValue value);
SettingValue value_of(const Config& config, const Setting& setting);
/// As it is written in TOML: "text", true, 12, ["a", "b"].
std::string toml_of(const SettingValue& value);

/// Which of `names` was probably meant; empty: none is near.
std::string closest_to(std::string_view wanted, std::span<const std::string> names);
/// Says that there is no such key, and which one was probably meant.
Error unknown_setting(std::string_view path);

/// What single settings cannot say: addresses, and that nobody listens beyond loopback without meaning it.
Result<void> check_config(const Config& config);

/// An "address:port"; IPv6 as "[::1]:7490". Errors: kInvalidArgument.
struct Address {
  std::string host;
  std::uint16_t port = 0;
  bool loopback = false;
};
Result<Address> parse_address(std::string_view text);

}  // namespace eigencast::broker
