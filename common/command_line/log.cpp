// SPDX-License-Identifier: MIT
#include "common/command_line/log.h"

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <utility>

namespace eigencast {
namespace {

spdlog::level::level_enum spdlog_level(LogLevel level) {
  constexpr spdlog::level::level_enum kLevels[] = {spdlog::level::debug, spdlog::level::info, spdlog::level::warn,
                                                   spdlog::level::err};
  return kLevels[static_cast<int>(level)];
}

}  // namespace

std::shared_ptr<spdlog::logger> stderr_logger(LogLevel min_level, LogFormat format) {
  const char* no_color = std::getenv("NO_COLOR");
  const bool plain = format != LogFormat::kTerminal || (no_color && *no_color);
  auto logger =
      std::make_shared<spdlog::logger>("", std::make_shared<spdlog::sinks::stderr_color_sink_mt>(
                                               plain ? spdlog::color_mode::never : spdlog::color_mode::automatic));
  logger->set_pattern(format == LogFormat::kJson   ? R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l","message":%v})"
                      : format == LogFormat::kText ? "%Y-%m-%d %H:%M:%S.%e %l %v"
                                                   : "%H:%M:%S.%e %^%l%$ %v");
  logger->set_level(spdlog_level(min_level));
  return logger;
}

LogSink sink_to(std::shared_ptr<spdlog::logger> logger) {
  return [logger = std::move(logger)](LogLevel level, std::string_view message) {
    logger->log(spdlog_level(level), spdlog::string_view_t(message.data(), message.size()));
  };
}

}  // namespace eigencast
