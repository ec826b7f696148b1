// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/config/config.h"

/// Paths of the broker's files, by the folders that systemd names in the environment (systemd.exec(5)).
namespace eigencast::broker {

/// The folder of assets and recordings: server.data_dir, $STATE_DIRECTORY, $XDG_STATE_HOME/eigencast or
/// ~/.local/state/eigencast.
std::string data_dir_of(const Config& config);

/// The path of a file that a setting names. A relative path is searched in $CREDENTIALS_DIRECTORY, then in
/// $CONFIGURATION_DIRECTORY, then refers to the current folder.
std::string resolved_path(const std::string& path);

/// $CONFIGURATION_DIRECTORY/eigencast.toml; empty: it does not exist.
std::string default_config_file();

}  // namespace eigencast::broker
