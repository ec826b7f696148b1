// SPDX-License-Identifier: MIT
#include "broker/config/config.h"

#include <algorithm>
#include <charconv>
#include <utility>

#include "common/core/text.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

constexpr std::int64_t kMany = std::int64_t{1} << 40;

struct Table {
  std::vector<Setting> rows;
  std::vector<std::pair<std::string_view, std::string_view>> sections;
};

Table make_table() {
  constexpr bool live = true;
  constexpr bool restart = false;
  Table table;
#define SECTION(section, doc)                           \
  {                                                     \
    static constexpr auto kSection = &Config::section;  \
    static constexpr std::string_view kName = #section; \
    table.sections.emplace_back(kName, doc);
#define END(section) }
#define FIELD(name) [](Config& c) -> Setting::Field { return &(c.*kSection).name; }
#define TEXT(name, value, when, doc) table.rows.push_back({kName, #name, FIELD(name), doc, when, false, 0, 0, {}, {}});
#define SECRET(name, when, doc) table.rows.push_back({kName, #name, FIELD(name), doc, when, true, 0, 0, {}, {}});
#define CHOICE(name, value, choices, when, doc) \
  table.rows.push_back({kName, #name, FIELD(name), doc, when, false, 0, 0, {}, choices});
#define LIST(name, values, when, doc) TEXT(name, {}, when, doc)
#define FLAG(name, value, when, doc) TEXT(name, {}, when, doc)
#define NUMBER(name, value, min, max, unit, when, doc) \
  table.rows.push_back({kName, #name, FIELD(name), doc, when, false, min, max, unit, {}});
#define CHOICES(...) \
  { __VA_ARGS__ }
#define DEFAULTS(...)
#include "broker/config/settings.def"
#undef FIELD
  return table;
}

const Table& table() {
  static const Table made = make_table();
  return made;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t swapped = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = std::exchange(row[j], std::min({row[j] + 1, row[j - 1] + 1, swapped}));
    }
  }
  return row.back();
}

Error setting_error(const Setting& setting, const std::string& what) {
  return fail(ErrorCode::kInvalidArgument, setting.path() + " " + what);
}

Result<void> check_value(const Setting& setting, const SettingValue& value) {
  if (const auto* text = std::get_if<std::string>(&value)) {
    if (setting.choices.empty()) return {};
    if (std::find(setting.choices.begin(), setting.choices.end(), *text) != setting.choices.end()) return {};
    std::string allowed;
    for (const auto choice : setting.choices) allowed += (allowed.empty() ? "" : ", ") + std::string(choice);
    return setting_error(setting, "= '" + *text + "' is none of: " + allowed);
  }
  const auto* number = std::get_if<std::int64_t>(&value);
  if (number == nullptr || (*number >= setting.min && *number <= setting.max)) return {};
  return setting_error(setting, "= " + std::to_string(*number) + " is outside " + std::to_string(setting.min) + ".." +
                                    std::to_string(setting.max));
}

std::vector<std::string> items_of(std::string_view text) {
  std::vector<std::string> items;
  for (const std::string_view part : split(text, ',')) {
    if (const auto item = trimmed(part); !item.empty()) items.emplace_back(item);
  }
  return items;
}

Result<SettingValue> value_from_text(const Setting& setting, const Setting::Field& field, std::string_view text) {
  if (std::holds_alternative<std::string*>(field)) return SettingValue(std::string(text));
  if (std::holds_alternative<std::vector<std::string>*>(field)) return SettingValue(items_of(text));
  if (std::holds_alternative<bool*>(field)) {
    if (text == "true" || text == "false") return SettingValue(text == "true");
    return setting_error(setting, "must be true or false, not '" + std::string(text) + "'");
  }
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error == std::errc() && end == text.data() + text.size() && !text.empty()) return SettingValue(number);
  return setting_error(setting, "must be a whole number, not '" + std::string(text) + "'");
}

std::string toml_quoted(std::string_view text) {
  constexpr std::string_view kHex = "0123456789ABCDEF";
  std::string out = "\"";
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (byte < 0x20 || byte == 0x7F) {
      out += "\\u00";
      out += kHex[byte >> 4];
      out += kHex[byte & 15];
    } else {
      out += c;
    }
  }
  return out + "\"";
}

}  // namespace

std::span<const Setting> settings() {
  return table().rows;
}

const Setting* find_setting(std::string_view path) {
  for (const Setting& setting : settings()) {
    if (setting.path() == path) return &setting;
  }
  return nullptr;
}

std::string_view section_doc(std::string_view section) {
  for (const auto& [name, doc] : table().sections) {
    if (name == section) return doc;
  }
  return {};
}

std::string closest_to(std::string_view wanted, std::span<const std::string> names) {
  std::string best;
  std::size_t least = wanted.size() / 2 + 1;
  for (const std::string& name : names) {
    const std::size_t distance = edit_distance(wanted, name);
    if (distance >= least) continue;
    least = distance;
    best = name;
  }
  return best;
}

Error unknown_setting(std::string_view path) {
  path = path.substr(0, 100);
  std::vector<std::string> paths;
  for (const Setting& setting : settings()) paths.push_back(setting.path());
  const std::string meant = closest_to(path, paths);
  std::string message = "unknown key '" + std::string(path) + "'";
  if (!meant.empty()) message += "; did you mean '" + meant + "'?";
  return fail(ErrorCode::kInvalidArgument, std::move(message));
}

Result<void> set_config(Config& config, std::string_view path, std::string_view value) {
  const Setting* setting = find_setting(path);
  if (setting == nullptr) return unknown_setting(path);
  auto typed = value_from_text(*setting, setting->field(config), value);
  if (!typed) return typed.error();
  return set_config(config, *setting, std::move(*typed));
}

Result<void> set_config(Config& config, const Setting& setting, SettingValue value) {
  const Setting::Field field = setting.field(config);
  if (field.index() != value.index()) {
    constexpr const char* kMust[] = {"must be a text in quotes", "must be true or false", "must be a whole number",
                                     "must be a list of texts: [\"a\", \"b\"]"};
    return setting_error(setting, kMust[field.index()]);
  }
  if (auto good = check_value(setting, value); !good) return good;
  std::visit([&](auto* target) { *target = std::get<std::remove_pointer_t<decltype(target)>>(std::move(value)); },
             field);
  return {};
}

SettingValue value_of(const Config& config, const Setting& setting) {
  // The table's accessors return mutable pointers; this one is only read.
  return std::visit([](const auto* target) { return SettingValue(*target); },
                    setting.field(const_cast<Config&>(config)));
}

std::string toml_of(const SettingValue& value) {
  if (const auto* text = std::get_if<std::string>(&value)) return toml_quoted(*text);
  if (const auto* flag = std::get_if<bool>(&value)) return *flag ? "true" : "false";
  if (const auto* number = std::get_if<std::int64_t>(&value)) return std::to_string(*number);
  std::string list = "[";
  for (const std::string& item : std::get<std::vector<std::string>>(value)) {
    list += (list.size() > 1 ? ", " : "") + toml_quoted(item);
  }
  return list + "]";
}

}  // namespace eigencast::broker
