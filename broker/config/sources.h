// SPDX-License-Identifier: MIT
#pragma once

#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "broker/config/config.h"

namespace eigencast::broker {

/// Origins of settings that differ from their default, by path: "eigencast.toml:12", "--listen",
/// "EIGENCAST_LIMITS__MAX_STREAMS".
using Origins = std::map<std::string, std::string, std::less<>>;

struct LoadedConfig {
  Config config;
  Origins origins;
};

/// Applies a TOML text. `name` is for messages.
/// Errors: kInvalidArgument (syntax, unknown key with a suggestion, wrong type, out of range), with the line.
Result<void> read_config(LoadedConfig& loaded, std::string_view toml, std::string_view name);

/// Applies EIGENCAST_SECTION__KEY of `environment` ("NAME=value"). Ignores names without __, except those that a second
/// underscore would make a setting's: these are refused. Errors: as above.
Result<void> read_environment(LoadedConfig& loaded, std::span<const std::string> environment);

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
  /// --share: unless one is set, the secret for tokens, and an address beyond this machine. Empty: not given.
  std::string share_secret = {};
};

/// Reads all sources and checks the result. Errors: as above; of the file kNotFound, kIo, kTooLarge (over 1 MiB).
Result<LoadedConfig> load_config(const ConfigSources& sources);

}  // namespace eigencast::broker
