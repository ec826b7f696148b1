// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <memory>
#include <mutex>

#include "broker/http/http_target.h"
#include "broker/operation/log_throttle.h"
#include "common/core/clock.h"

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

/// What peers have sent may hold anything: a line stays one line, without control characters.
std::string one_line(std::string text) {
  for (char& c : text) c = static_cast<unsigned char>(c) < 0x20 || c == 127 ? ' ' : c;
  return text;
}

}  // namespace

LogSink make_log_sink(const std::string& level, const std::string& format) {
  auto logger = std::make_shared<spdlog::logger>("broker", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  const bool json = format == "json";
  logger->set_pattern(json ? R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l","message":%v})"
                           : "%Y-%m-%d %H:%M:%S.%e %l %v");
  logger->set_level(spdlog::level::from_str(level));
  logger->flush_on(spdlog::level::info);
  struct Shared {
    std::mutex mutex;
    LogThrottle throttle;  // GUARDED_BY(mutex)
  };
  return [logger, json, shared = std::make_shared<Shared>()](LogLevel line_level, std::string_view message) {
    if (!logger->should_log(level_from(line_level))) return;
    std::optional<std::uint64_t> left_out;
    {
      const std::lock_guard lock(shared->mutex);
      left_out = shared->throttle.admit(message, steady_now_us());
    }
    if (!left_out) return;
    std::string text(message);
    if (*left_out > 0) text += " (repeated " + std::to_string(*left_out) + " times meanwhile)";
    logger->log(level_from(line_level), json ? json_quoted(text) : one_line(text));
  };
}

}  // namespace eigencast::broker
