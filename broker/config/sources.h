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

/// Where each setting that is not at its default came from: "eigencast.toml:12", "--listen",
/// "EIGENCAST_LIMITS__MAX_STREAMS". By path.
using Origins = std::map<std::string, std::string, std::less<>>;

/// Reads a TOML text over `config`. `name` stands in messages.
/// Errors: kInvalidArgument (syntax, unknown key with a suggestion, wrong type, out of range), with the line.
Result<void> read_config(Config& config, std::string_view toml, std::string_view name, Origins* origins = nullptr);
/// The same from a file. Errors: kNotFound, kIo, kTooLarge (over 1 MiB), and those above.
Result<void> read_config_file(Config& config, const std::string& path, Origins* origins = nullptr);

/// Reads EIGENCAST_SECTION__KEY of `environment` ("NAME=value" lines) over `config`. Names without __ are of other
/// programs, and left alone, unless a second underscore would make them a setting's. Errors: as above.
Result<void> read_environment(Config& config, std::span<const std::string_view> environment,
                              Origins* origins = nullptr);

/// Where settings come from: flags win over the environment, that over the file, that over the defaults. Kept, so that
/// a reload reads the same sources again.
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

/// Reads all sources and checks the whole. Errors: as above.
Result<LoadedConfig> load_config(const ConfigSources& sources);

}  // namespace eigencast::broker
