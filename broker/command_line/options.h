// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "broker/config/sources.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// The parsed command line, with the configuration merged from all sources: flags > environment > file > default.
struct Options {
  ConfigSources sources;  ///< Read again by a reload.
  LoadedConfig loaded;
  std::string port_file;              ///< Empty: none.
  bool check_only = false;            ///< --check-config
  std::optional<std::string> answer;  ///< Text to print before exiting with 0 (--help, --version, --show-config...).
};

/// Every setting has a flag: --section-name, those of [server] --name.
/// Errors: kInvalidArgument, kNotFound, kIo: all are usage errors, exit code 2.
Result<Options> read_options(int argc, const char* const* argv, std::span<const std::string_view> environment,
                             std::string_view version);

}  // namespace eigencast::broker
