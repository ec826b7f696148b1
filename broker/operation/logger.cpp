// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <memory>

#include "broker/http/http_target.h"

namespace eigencast::broker {
namespace {

spdlog::level::level_enum level_from(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      return spdlog::level::err;
  }
  return spdlog::level::err;
}

}  // namespace

LogSink make_log_sink(const std::string& level, const std::string& format) {
  auto logger = std::make_shared<spdlog::logger>("broker", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  const bool json = format == "json";
  logger->set_pattern(json ? R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l","message":%v})"
                           : "%Y-%m-%d %H:%M:%S.%e %l %v");
  logger->set_level(spdlog::level::from_str(level));
  logger->flush_on(spdlog::level::info);
  return [logger, json](LogLevel line_level, std::string_view message) {
    if (json) {
      logger->log(level_from(line_level), json_quoted(message));
    } else {
      logger->log(level_from(line_level), message);
    }
  };
}

}  // namespace eigencast::broker
