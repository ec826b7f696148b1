// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <cstdio>
#include <cstdlib>
#include <exception>

#include "common/command_line/log.h"
#include "sender/commands.h"

int main(int argc, char** argv) {
  try {
    const eigencast::Invocation invocation = eigencast::parse_command_line(argc, argv);
    if (!invocation.run) return invocation.status;
    // The options have it; other brokers that are watched must not get it.
    ::unsetenv("EIGENCAST_TOKEN");
    spdlog::set_default_logger(
        eigencast::stderr_logger(invocation.verbose ? eigencast::LogLevel::kDebug : eigencast::LogLevel::kInfo));
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
