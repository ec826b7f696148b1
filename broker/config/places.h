// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/config/config.h"

/// Where the files of a broker are. systemd says so in the environment of the services that it starts
/// (systemd.exec(5)): a unit needs no paths then, and a file of settings none either.
namespace eigencast::broker {

/// Where assets and recordings go: server.data_dir, $STATE_DIRECTORY, $XDG_STATE_HOME/eigencast,
/// ~/.local/state/eigencast.
std::string data_dir_of(const Config& config);

/// A file that a setting names. A path that begins with '/' is itself; another is looked for in $CREDENTIALS_DIRECTORY,
/// then in $CONFIGURATION_DIRECTORY; where it is in neither, it is one of the current folder.
std::string located(const std::string& path);

/// $CONFIGURATION_DIRECTORY/eigencast.toml, for a broker that is given no file; empty: there is none.
std::string default_config_file();

}  // namespace eigencast::broker
