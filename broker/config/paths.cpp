// SPDX-License-Identifier: MIT
#include <cstdlib>
#include <filesystem>
#include <system_error>

#include "broker/config/config.h"

namespace eigencast::broker {
namespace {

/// The first folder of a colon-separated list; empty: none.
std::string folder_from(const char* variable) {
  const char* value = std::getenv(variable);
  if (value == nullptr || *value != '/') return {};
  const std::string folders(value);
  return folders.substr(0, folders.find(':'));
}

bool exists(const std::string& path) {
  std::error_code unknown;
  return std::filesystem::exists(path, unknown);
}

}  // namespace

std::string data_dir_of(const Config& config) {
  if (!config.server.data_dir.empty()) return config.server.data_dir;
  if (std::string state = folder_from("STATE_DIRECTORY"); !state.empty()) return state;
  if (const std::string state = folder_from("XDG_STATE_HOME"); !state.empty()) return state + "/eigencast";
  const char* home = std::getenv("HOME");
  return std::string(home != nullptr && *home != '\0' ? home : ".") + "/.local/state/eigencast";
}

std::string resolved_path(const std::string& path) {
  if (path.empty() || path.starts_with('/')) return path;
  for (const char* variable : {"CREDENTIALS_DIRECTORY", "CONFIGURATION_DIRECTORY"}) {
    const std::string folder = folder_from(variable);
    if (!folder.empty() && exists(folder + "/" + path)) return folder + "/" + path;
  }
  return path;
}

std::string default_config_file() {
  const std::string folder = folder_from("CONFIGURATION_DIRECTORY");
  const std::string file = folder + "/eigencast.toml";
  return !folder.empty() && exists(file) ? file : std::string();
}

}  // namespace eigencast::broker
