// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace CLI {
class App;
}

namespace eigencast::broker {

struct CommandEnd {
  int code = 0;     ///< 0; 1: the token would be refused; 2: usage or configuration.
  std::string out;  ///< For standard output.
  std::string err;  ///< For standard error.
};

/// eigencast-broker token create|inspect ...; argv[0] is "token". `input` holds the token if it is given as "-".
CommandEnd token_command(int argc, const char* const* argv, std::span<const std::string_view> environment,
                         std::int64_t now_unix_s, const std::string& input);

/// Adds its options to `app` as command "token", for help, manual page and completion.
void describe_token_command(CLI::App& app);

}  // namespace eigencast::broker
