// SPDX-License-Identifier: MIT
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <exception>

#include "sender/command_line.h"

int main(int argc, char** argv) {
  try {
    const eigencast::Invocation invocation = eigencast::parse_command_line(argc, argv);
    if (!invocation.run) return invocation.status;
    spdlog::set_default_logger(spdlog::stderr_color_mt("eigencast-sender"));
    spdlog::set_pattern("%H:%M:%S.%e %^%l%$ %v");
    if (invocation.verbose) spdlog::set_level(spdlog::level::debug);
    eigencast::Interrupt interrupt;
    return invocation.run(interrupt);
  } catch (const std::exception& error) {
    spdlog::critical("unexpected: {}", error.what());
    return eigencast::kExitFailed;
  }
}
