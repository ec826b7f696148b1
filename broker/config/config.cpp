// SPDX-License-Identifier: MIT
#include "broker/config/config.h"

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <charconv>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>

#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

constexpr std::int64_t kMany = std::int64_t{1} << 40;

#define FIELD(path) [](Config& c) -> ConfigKey::Field { return &c.path; }

const std::vector<ConfigKey>& keys() {
  static const std::vector<ConfigKey> all = {
      {"server", "listen", FIELD(server.listen), 0, 0, {}},
      {"server", "admin_listen", FIELD(server.admin_listen), 0, 0, {}},
      {"server", "data_dir", FIELD(server.data_dir), 0, 0, {}},
      {"server", "allow_anonymous", FIELD(server.allow_anonymous), 0, 0, {}},
      {"log", "level", FIELD(log.level), 0, 0, {"debug", "info", "warning", "error"}},
      {"log", "format", FIELD(log.format), 0, 0, {"text", "json"}},
      {"limits", "max_connections", FIELD(limits.max_connections), 1, 10'000'000, {}},
      {"limits", "max_streams", FIELD(limits.max_streams), 1, 1'000'000, {}},
      {"limits", "max_subscribers_per_stream", FIELD(limits.max_subscribers_per_stream), 1, 10'000'000, {}},
      {"limits", "max_profiles_per_stream", FIELD(limits.max_profiles_per_stream), 1, 1'000, {}},
      {"limits", "max_streams_per_connection", FIELD(limits.max_streams_per_connection), 1, 1'000, {}},
      {"limits", "max_frame_bytes", FIELD(limits.max_frame_bytes), 1'024, limits::kMaxFrameBytes, {}},
      {"limits", "max_control_bytes", FIELD(limits.max_control_bytes), 1'024, limits::kMaxControlBytes, {}},
      {"limits", "max_queued_control_messages", FIELD(limits.max_queued_control_messages), 16, 1'000'000, {}},
      {"limits", "max_queued_control_bytes", FIELD(limits.max_queued_control_bytes), 65'536, kMany, {}},
      {"limits", "max_uploads", FIELD(limits.max_uploads), 1, 10'000, {}},
      {"assets", "max_object_bytes", FIELD(assets.max_object_bytes), 1, limits::kMaxAssetObjectBytes, {}},
      {"assets", "max_total_bytes", FIELD(assets.max_total_bytes), 1, kMany, {}},
      {"timeouts", "header_ms", FIELD(timeouts.header_ms), 100, 600'000, {}},
      {"timeouts", "transfer_ms", FIELD(timeouts.transfer_ms), 100, 3'600'000, {}},
      {"timeouts", "idle_ms", FIELD(timeouts.idle_ms), 1'000, 3'600'000, {}},
      {"timeouts", "shutdown_ms", FIELD(timeouts.shutdown_ms), 10, 60'000, {}},
      {"frames", "max_span_ms", FIELD(frames.max_span_ms), 1, 60'000, {}},
      {"frames", "window_ms", FIELD(frames.window_ms), 1, 60'000, {}},
  };
  return all;
}

#undef FIELD

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

Error unknown_key(std::string_view path) {
  std::string best;
  std::size_t least = path.size() / 2 + 1;
  for (const ConfigKey& key : keys()) {
    const std::size_t distance = edit_distance(path.substr(0, 100), key.path());
    if (distance < least) {
      least = distance;
      best = key.path();
    }
  }
  std::string message = "unknown key '" + std::string(path) + "'";
  if (!best.empty()) message += "; did you mean '" + best + "'?";
  return fail(ErrorCode::kInvalidArgument, std::move(message));
}

const ConfigKey* find_key(std::string_view path) {
  for (const ConfigKey& key : keys()) {
    if (key.path() == path) return &key;
  }
  return nullptr;
}

Result<void> assign(Config& config, const ConfigKey& key, std::string_view value) {
  auto* text = std::get<std::string*>(key.field(config));
  if (!key.choices.empty() && std::find(key.choices.begin(), key.choices.end(), value) == key.choices.end()) {
    std::string allowed;
    for (const auto choice : key.choices) allowed += (allowed.empty() ? "" : ", ") + std::string(choice);
    return fail(ErrorCode::kInvalidArgument, key.path() + " = '" + std::string(value) + "' is none of: " + allowed);
  }
  *text = value;
  return {};
}

Result<void> assign(Config& config, const ConfigKey& key, std::int64_t value) {
  if (value < key.least || value > key.most) {
    return fail(ErrorCode::kInvalidArgument, key.path() + " = " + std::to_string(value) + " is outside " +
                                                 std::to_string(key.least) + ".." + std::to_string(key.most));
  }
  *std::get<std::int64_t*>(key.field(config)) = value;
  return {};
}

Result<void> assign_node(Config& config, const ConfigKey& key, const toml::node& node) {
  const ConfigKey::Field field = key.field(config);
  if (std::holds_alternative<std::string*>(field)) {
    if (const auto* value = node.as_string()) return assign(config, key, value->get());
    return fail(ErrorCode::kInvalidArgument, key.path() + " must be a text in quotes");
  }
  if (std::holds_alternative<std::int64_t*>(field)) {
    if (const auto* value = node.as_integer()) return assign(config, key, value->get());
    return fail(ErrorCode::kInvalidArgument, key.path() + " must be a whole number");
  }
  if (const auto* value = node.as_boolean()) {
    *std::get<bool*>(field) = value->get();
    return {};
  }
  return fail(ErrorCode::kInvalidArgument, key.path() + " must be true or false");
}

std::string upper(std::string_view text) {
  std::string out(text);
  for (char& c : out) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  return out;
}

std::string lower(std::string_view text) {
  std::string out(text);
  for (char& c : out) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return out;
}

}  // namespace

std::span<const ConfigKey> config_keys() {
  return keys();
}

Result<void> set_config(Config& config, std::string_view path, std::string_view value) {
  const ConfigKey* key = find_key(path);
  if (key == nullptr) return unknown_key(path);
  const ConfigKey::Field field = key->field(config);
  if (std::holds_alternative<std::string*>(field)) return assign(config, *key, value);
  if (std::holds_alternative<bool*>(field)) {
    if (value != "true" && value != "false") {
      return fail(ErrorCode::kInvalidArgument,
                  key->path() + " must be true or false, not '" + std::string(value) + "'");
    }
    *std::get<bool*>(field) = value == "true";
    return {};
  }
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), number);
  if (error != std::errc() || end != value.data() + value.size()) {
    return fail(ErrorCode::kInvalidArgument, key->path() + " must be a whole number, not '" + std::string(value) + "'");
  }
  return assign(config, *key, number);
}

Result<void> read_config(Config& config, std::string_view toml, std::string_view name) {
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
    if (table == nullptr) return in_context(at(node.source()), unknown_key(section.str()));
    for (const auto& [key_name, value] : *table) {
      const std::string path = std::string(section.str()) + "." + std::string(key_name.str());
      const ConfigKey* key = find_key(path);
      if (key == nullptr) return in_context(at(value.source()), unknown_key(path));
      if (auto set = assign_node(config, *key, value); !set) return in_context(at(value.source()), set.error());
    }
  }
  return {};
}

Result<void> read_config_file(Config& config, const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return fail(ErrorCode::kNotFound, path + ": cannot be opened: check the path and its permissions");
  std::ostringstream text;
  text << file.rdbuf();
  if (file.bad() || text.bad()) return fail(ErrorCode::kIo, path + ": cannot be read");
  return read_config(config, text.str(), path);
}

Result<void> read_environment(Config& config, std::span<const std::string_view> environment) {
  for (const std::string_view entry : environment) {
    const auto equals = entry.find('=');
    const std::string_view name = entry.substr(0, equals);
    constexpr std::string_view kPrefix = "EIGENCAST_";
    const auto split = name.find("__");
    if (equals == std::string_view::npos || !name.starts_with(kPrefix) || split == std::string_view::npos) continue;
    const std::string_view section = name.substr(kPrefix.size(), split - kPrefix.size());
    const bool ours =
        std::any_of(keys().begin(), keys().end(), [&](const auto& key) { return upper(key.section) == section; });
    if (!ours) continue;
    const std::string path = lower(section) + "." + lower(name.substr(split + 2));
    if (auto set = set_config(config, path, entry.substr(equals + 1)); !set) {
      return in_context("environment variable " + std::string(name), set.error());
    }
  }
  return {};
}

Result<Address> parse_address(std::string_view text) {
  const auto wrong = [&] {
    return fail(
        ErrorCode::kInvalidArgument,
        "'" + std::string(text) + "' is no address: write ADDRESS:PORT, for example 127.0.0.1:7490 or [::1]:7490");
  };
  const auto colon = text.rfind(':');
  if (colon == std::string_view::npos) return wrong();
  std::string_view host = text.substr(0, colon);
  const std::string_view port = text.substr(colon + 1);
  if (host.starts_with('[') && host.ends_with(']')) {
    host = host.substr(1, host.size() - 2);
  } else if (host.find(':') != std::string_view::npos) {
    return wrong();
  }
  Address address{host == "localhost" ? std::string("127.0.0.1") : std::string(host), 0, false};
  const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), address.port);
  if (error != std::errc() || end != port.data() + port.size() || port.empty()) return wrong();
  boost::system::error_code code;
  const auto ip = boost::asio::ip::make_address(address.host, code);
  if (code) return wrong();
  address.loopback = ip.is_loopback();
  return address;
}

Result<void> check_config(const Config& config) {
  const auto listen = parse_address(config.server.listen);
  if (!listen) return in_context("server.listen", listen.error());
  const auto admin = parse_address(config.server.admin_listen);
  if (!admin) return in_context("server.admin_listen", admin.error());
  if (!listen->loopback && !config.server.allow_anonymous) {
    return fail(ErrorCode::kInvalidArgument,
                "server.listen = '" + config.server.listen +
                    "' reaches beyond this machine, where anybody could publish and watch, because this version asks "
                    "nobody who "
                    "they are: listen on 127.0.0.1 (behind a proxy that checks), or set server.allow_anonymous = true");
  }
  if (!admin->loopback) {
    return fail(ErrorCode::kInvalidArgument,
                "server.admin_listen = '" + config.server.admin_listen +
                    "' reaches beyond this machine: the admin listener is for loopback only");
  }
  return {};
}

std::string data_dir_of(const Config& config) {
  if (!config.server.data_dir.empty()) return config.server.data_dir;
  const char* state = std::getenv("XDG_STATE_HOME");
  if (state != nullptr && *state == '/') return std::string(state) + "/eigencast";
  const char* home = std::getenv("HOME");
  return std::string(home != nullptr && *home != '\0' ? home : ".") + "/.local/state/eigencast";
}

}  // namespace eigencast::broker
