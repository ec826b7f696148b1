// SPDX-License-Identifier: MIT
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <cstdio>
#include <cstdlib>
#include <exception>

#include "sender/command_line.h"

int main(int argc, char** argv) {
  try {
    const eigencast::Invocation invocation = eigencast::parse_command_line(argc, argv);
    if (!invocation.run) return invocation.status;
    // Where it was meant for, it is in the options; other brokers that are watched must not get it.
    ::unsetenv("EIGENCAST_TOKEN");
    const char* no_color = std::getenv("NO_COLOR");
    spdlog::set_default_logger(spdlog::stderr_color_mt(
        "eigencast-sender", no_color && *no_color ? spdlog::color_mode::never : spdlog::color_mode::automatic));
    spdlog::set_pattern("%H:%M:%S.%e %^%l%$ %v");
    if (invocation.verbose) spdlog::set_level(spdlog::level::debug);
    eigencast::Interrupt interrupt;
    const int status = invocation.run(interrupt);
    if ((std::fflush(stdout) != 0 || std::ferror(stdout) != 0) && status == eigencast::kExitOk) {
      spdlog::error("standard output cannot be written");
      return eigencast::kExitFailed;
    }
    return status;
  } catch (const std::exception& error) {
    spdlog::critical("unexpected: {}", error.what());
    return eigencast::kExitFailed;
  }
}
