// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "broker/config/sources.h"

namespace eigencast::broker {

/// The documented configuration file with every default: deploy/eigencast.toml.
std::string default_file();

/// Every setting as TOML with its origin; secrets as "(set)".
std::string shown_config(const LoadedConfig& loaded);

struct ConfigChange {
  std::string path;
  std::string before;  ///< As TOML; secrets as "(set)" or "".
  std::string after;
  bool live = false;  ///< False: needs a restart.
};
std::vector<ConfigChange> changes_between(const Config& before, const Config& after);

/// `running` with the reloadable settings of `wanted`.
Config reloaded(const Config& running, const Config& wanted);

}  // namespace eigencast::broker
