// SPDX-License-Identifier: MIT
#include "broker/config/sources.h"

#include <algorithm>
#include <optional>

#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

#include "common/core/files.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxConfigBytes = 1 << 20;

/// Nothing for types that no setting has.
std::optional<SettingValue> value_from_node(const toml::node& node) {
  if (const auto* text = node.as_string()) return SettingValue(text->get());
  if (const auto* flag = node.as_boolean()) return SettingValue(flag->get());
  if (const auto* number = node.as_integer()) return SettingValue(number->get());
  const auto* array = node.as_array();
  if (array == nullptr) return std::nullopt;
  std::vector<std::string> items;
  for (const toml::node& item : *array) {
    const auto* text = item.as_string();
    if (text == nullptr) return std::nullopt;
    items.push_back(text->get());
  }
  return SettingValue(std::move(items));
}

std::string lower(std::string_view text) {
  std::string out(text);
  for (char& c : out) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return out;
}

std::string_view unindented(std::string_view text) {
  return text.substr(std::min(text.find_first_not_of(" \t"), text.size()));
}

/// Whether the line is a header without a valid name, as "[!access]". No setting's value begins a line with a bracket.
bool is_broken_header(std::string_view line) {
  constexpr std::string_view kBegins = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-\"']";
  line = unindented(line);
  if (!line.starts_with('[')) return false;
  line = unindented(line.substr(line.starts_with("[[") ? 2 : 1));
  return line.empty() || kBegins.find(line.front()) == std::string_view::npos;
}

/// Whether it has non-ASCII characters outside comments and strings.
bool has_stray_characters(std::string_view line) {
  char quote = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (quote != 0) {
      if (c == '\\' && quote == '"') ++i;
      if (c == quote) quote = 0;
    } else if (c == '#') {
      return false;
    } else if (c == '"' || c == '\'') {
      quote = c;
    } else if (static_cast<unsigned char>(c) >= 0x80) {
      return true;
    }
  }
  return false;
}

/// Refuses input on which toml++ 3.3 fails an assertion, which would end a broker that reloads.
Result<void> check_readable(std::string_view toml, std::string_view name) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (toml.starts_with(kByteOrderMark)) toml.remove_prefix(kByteOrderMark.size());
  for (std::size_t number = 1; !toml.empty();) {
    const std::size_t end = std::min(toml.find_first_of("\n\r\v\f"), toml.size());
    const std::string_view line = toml.substr(0, end);
    const char* flaw = is_broken_header(line) ? "'[' must begin the name of a section, such as [access]"
                       : has_stray_characters(line)
                           ? "only strings on one line, and comments, may hold other than ASCII"
                           : nullptr;
    if (flaw != nullptr)
      return fail(ErrorCode::kInvalidArgument, std::string(name) + ":" + std::to_string(number) + ": " + flaw);
    if (end < toml.size() && toml[end] == '\n') ++number;
    toml.remove_prefix(std::min(end + 1, toml.size()));
  }
  return {};
}

/// The name with two underscores if EIGENCAST_`rest` would name a setting with a second one; else empty.
std::string meant_by(std::string_view rest) {
  for (std::size_t at = rest.find('_'); at != std::string_view::npos; at = rest.find('_', at + 1)) {
    const std::string_view section = rest.substr(0, at), key = rest.substr(at + 1);
    if (find_setting(lower(section) + "." + lower(key)) != nullptr)
      return std::string(section) + "__" + std::string(key);
  }
  return {};
}

}  // namespace

Result<void> read_config(LoadedConfig& loaded, std::string_view toml, std::string_view name) {
  if (auto readable = check_readable(toml, name); !readable) return readable;
  const toml::parse_result parsed = toml::parse(toml, name);
  const auto at = [&](const toml::source_region& where) {
    return std::string(name) + ":" + std::to_string(where.begin.line);
  };
  if (!parsed) {
    return fail(ErrorCode::kInvalidArgument,
                at(parsed.error().source()) + ": " + std::string(parsed.error().description()));
  }
  for (const auto& [section, node] : parsed.table()) {
    const toml::table* table = node.as_table();
    if (table == nullptr || (table->empty() && section_doc(section.str()).empty())) {
      return in_context(at(node.source()), unknown_setting(section.str()));
    }
    for (const auto& [key_name, node_of_value] : *table) {
      const std::string where = at(node_of_value.source());
      const std::string path = std::string(section.str()) + "." + std::string(key_name.str());
      const Setting* setting = find_setting(path);
      if (setting == nullptr) return in_context(where, unknown_setting(path));
      // A type that no setting has is refused as a type mismatch.
      auto value = value_from_node(node_of_value);
      if (!value) {
        const bool text = std::holds_alternative<std::string*>(setting->field(loaded.config));
        value = text ? SettingValue(false) : SettingValue(std::string());
      }
      const auto set = set_config(loaded.config, *setting, std::move(*value));
      if (!set) return in_context(where, set.error());
      loaded.origins[path] = where;
    }
  }
  return {};
}

Result<void> read_environment(LoadedConfig& loaded, std::span<const std::string> environment) {
  for (const std::string_view entry : environment) {
    const auto equals = entry.find('=');
    const std::string_view name = entry.substr(0, equals);
    constexpr std::string_view kPrefix = "EIGENCAST_";
    if (equals == std::string_view::npos || !name.starts_with(kPrefix)) continue;
    const auto split = name.find("__");
    if (split == std::string_view::npos) {
      const std::string meant = meant_by(name.substr(kPrefix.size()));
      if (meant.empty()) continue;
      return fail(ErrorCode::kInvalidArgument, "environment variable " + std::string(name) + ": did you mean " +
                                                   std::string(kPrefix) + meant +
                                                   "? Two underscores part section and key");
    }
    if (split < kPrefix.size()) continue;
    const std::string_view section = name.substr(kPrefix.size(), split - kPrefix.size());
    const std::string path = lower(section) + "." + lower(name.substr(split + 2));
    if (auto set = set_config(loaded.config, path, entry.substr(equals + 1)); !set) {
      return in_context("environment variable " + std::string(name), set.error());
    }
    loaded.origins[path] = name;
  }
  return {};
}

Result<LoadedConfig> load_config(const ConfigSources& sources) {
  LoadedConfig loaded;
  if (!sources.file.empty()) {
    const auto text = read_file(sources.file, kMaxConfigBytes);
    if (!text) return text.error();
    if (auto read = read_config(loaded, *text, sources.file); !read) return read.error();
  }
  if (auto read = read_environment(loaded, sources.environment); !read) return read.error();
  for (const auto& flag : sources.flags) {
    if (auto set = set_config(loaded.config, flag.path, flag.value); !set) return in_context(flag.name, set.error());
    loaded.origins[flag.path] = flag.name;
  }
  if (!sources.share_secret.empty()) {
    auto& [config, origins] = loaded;
    if (origins.emplace("server.listen", "--share").second) config.server.listen = "0.0.0.0:7490";
    if (origins.emplace("access.jwt_secret", "--share").second) config.access.jwt_secret = sources.share_secret;
  }
  if (auto good = check_config(loaded.config); !good) return good.error();
  return loaded;
}

}  // namespace eigencast::broker
