// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "broker/config/sources.h"

namespace eigencast::broker {

/// The configuration file with every setting at its default, each with its meaning: deploy/eigencast.toml.
std::string default_file();

/// Every setting as TOML with where its value came from; secrets as "(set)".
std::string shown_config(const LoadedConfig& loaded);

/// What a reload would do to one setting.
struct ConfigChange {
  std::string path;
  std::string before;  ///< As TOML; secrets as "(set)" or "".
  std::string after;
  bool live = false;  ///< False: it takes a restart.
};
std::vector<ConfigChange> changes_between(const Config& before, const Config& after);

/// `running` with the values that a reload may change taken from `wanted`.
Config reloaded(const Config& running, const Config& wanted);

}  // namespace eigencast::broker
