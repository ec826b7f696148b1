// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "broker/config/sources.h"
#include "common/core/result.h"

namespace CLI {
class App;
}

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
Result<Options> read_options(int argc, const char* const* argv, const std::vector<std::string>& environment,
                             std::string_view version);

struct CommandEnd {
  int code = 0;     ///< 0; 1: the token would be refused; 2: usage or configuration.
  std::string out;  ///< For standard output.
  std::string err;  ///< For standard error.
};

/// eigencast-broker token create|inspect ...; argv[0] is "token". `input` holds the token if it is given as "-".
CommandEnd token_command(int argc, const char* const* argv, const std::vector<std::string>& environment,
                         std::int64_t now_unix_s, const std::string& input);

/// Adds its options to `app` as command "token", for help, manual page and completion.
void describe_token_command(CLI::App& app);

}  // namespace eigencast::broker
