// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

/// Every setting of the broker, with its default. deploy/eigencast.toml documents each; a test compares the two.
struct Config {
  struct Server {
    std::string listen = "127.0.0.1:7490";
    std::string admin_listen = "127.0.0.1:7491";
    std::string data_dir;  ///< Empty: $XDG_STATE_HOME/eigencast, or ~/.local/state/eigencast.
    bool allow_anonymous = false;
  } server;
  struct Log {
    std::string level = "info";
    std::string format = "text";
  } log;
  struct Limits {
    std::int64_t max_connections = 20'000;
    std::int64_t max_streams = 1'024;
    std::int64_t max_subscribers_per_stream = 10'000;
    std::int64_t max_profiles_per_stream = 64;
    std::int64_t max_streams_per_connection = 64;
    std::int64_t max_frame_bytes = 1'048'576;
    std::int64_t max_control_bytes = 65'536;
    std::int64_t max_queued_control_messages = 256;
    std::int64_t max_queued_control_bytes = 1'048'576;
    std::int64_t max_uploads = 16;
  } limits;
  struct Assets {
    std::int64_t max_object_bytes = 268'435'456;
    std::int64_t max_total_bytes = 17'179'869'184;
  } assets;
  struct Timeouts {
    std::int64_t header_ms = 10'000;
    std::int64_t transfer_ms = 30'000;
    std::int64_t idle_ms = 30'000;
    std::int64_t shutdown_ms = 1'500;
  } timeouts;
  struct Frames {
    std::int64_t max_span_ms = 500;
    std::int64_t window_ms = 100;
  } frames;
};

/// One key of the configuration file: where its value lives and what it may be.
struct ConfigKey {
  using Field = std::variant<std::string*, bool*, std::int64_t*>;
  std::string_view section;
  std::string_view name;
  std::function<Field(Config&)> field;
  std::int64_t least = 0;                 ///< Of numbers.
  std::int64_t most = 0;                  ///< Of numbers.
  std::vector<std::string_view> choices;  ///< Of texts; empty = any.

  std::string path() const { return std::string(section) + "." + std::string(name); }
};

/// All keys, in the order of the default file.
std::span<const ConfigKey> config_keys();

/// Sets one key from text, as it comes from the environment or a flag.
/// Errors: kInvalidArgument (unknown key, with a suggestion; wrong type; out of range).
Result<void> set_config(Config& config, std::string_view path, std::string_view value);

/// Reads a TOML text over `config`. `name` stands in messages.
/// Errors: kInvalidArgument (syntax, unknown key with a suggestion, wrong type, out of range), with the line.
Result<void> read_config(Config& config, std::string_view toml, std::string_view name);
/// The same from a file. Errors: kNotFound, kIo, and those above.
Result<void> read_config_file(Config& config, const std::string& path);

/// Reads EIGENCAST_SECTION__KEY of `environment` ("NAME=value" lines) over `config`. Names of other sections are left
/// alone.
Result<void> read_environment(Config& config, std::span<const std::string_view> environment);

/// What single keys cannot say: addresses, and that nobody listens beyond loopback without meaning it.
Result<void> check_config(const Config& config);

/// An "address:port"; IPv6 as "[::1]:7490". Errors: kInvalidArgument.
struct Address {
  std::string host;
  std::uint16_t port = 0;
  bool loopback = false;
};
Result<Address> parse_address(std::string_view text);

/// data_dir, or its default from the environment.
std::string data_dir_of(const Config& config);

}  // namespace eigencast::broker
