// SPDX-License-Identifier: MIT
#pragma once

#include <map>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/config/config.h"

namespace eigencast::broker {

/// Origins of settings that differ from their default, by path: "eigencast.toml:12", "--listen",
/// "EIGENCAST_LIMITS__MAX_STREAMS".
using Origins = std::map<std::string, std::string, std::less<>>;

/// Applies a TOML text to `config`. `name` is for messages.
/// Errors: kInvalidArgument (syntax, unknown key with a suggestion, wrong type, out of range), with the line.
Result<void> read_config(Config& config, std::string_view toml, std::string_view name, Origins* origins = nullptr);
/// The same from a file. Errors: kNotFound, kIo, kTooLarge (over 1 MiB), and those above.
Result<void> read_config_file(Config& config, const std::string& path, Origins* origins = nullptr);

/// Applies EIGENCAST_SECTION__KEY of `environment` ("NAME=value"). Ignores names without __, except those that a second
/// underscore would make a setting's: these are refused. Errors: as above.
Result<void> read_environment(Config& config, std::span<const std::string_view> environment,
                              Origins* origins = nullptr);

/// Flags win over the environment, that over the file, that over the defaults. A reload reads them again.
struct ConfigSources {
  struct Flag {
    std::string name;  ///< --listen
    std::string path;  ///< server.listen
    std::string value;
  };
  std::string file;                      ///< Empty: none.
  std::vector<std::string> environment;  ///< "NAME=value"
  std::vector<Flag> flags;
};

struct LoadedConfig {
  Config config;
  Origins origins;
};

/// Reads all sources and checks the result. Errors: as above.
Result<LoadedConfig> load_config(const ConfigSources& sources);

}  // namespace eigencast::broker
