// SPDX-License-Identifier: MIT
#include "common/command_line/log.h"

#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <mutex>
#include <string>
#include <utility>

#include "common/core/text.h"

namespace eigencast {
namespace {

spdlog::level::level_enum spdlog_level(LogLevel level) {
  constexpr spdlog::level::level_enum kLevels[] = {spdlog::level::debug, spdlog::level::info, spdlog::level::warn,
                                                   spdlog::level::err};
  return kLevels[static_cast<int>(level)];
}

/// %*: the message, fit for a terminal. A message in JSON stays one.
class EscapedMessage final : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg& message, const std::tm&, spdlog::memory_buf_t& out) override {
    const std::string text = escaped({message.payload.data(), message.payload.size()});
    out.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override { return std::make_unique<EscapedMessage>(); }
};

}  // namespace

std::shared_ptr<spdlog::logger> stderr_logger(LogLevel min_level, LogFormat format) {
  const char* no_color = std::getenv("NO_COLOR");
  const bool plain = format != LogFormat::kTerminal || (no_color && *no_color);
  auto logger =
      std::make_shared<spdlog::logger>("", std::make_shared<spdlog::sinks::stderr_color_sink_mt>(
                                               plain ? spdlog::color_mode::never : spdlog::color_mode::automatic));
  auto formatter = std::make_unique<spdlog::pattern_formatter>();
  formatter->add_flag<EscapedMessage>('*').set_pattern(
      format == LogFormat::kJson   ? R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l","message":%*})"
      : format == LogFormat::kText ? "%Y-%m-%d %H:%M:%S.%e %l %*"
                                   : "%H:%M:%S.%e %^%l%$ %*");
  logger->set_formatter(std::move(formatter));
  logger->set_level(spdlog_level(min_level));
  return logger;
}

void write_line(spdlog::logger& logger, LogLevel level, std::string_view message, std::chrono::microseconds ago) {
  logger.log(spdlog::log_clock::now() - ago, spdlog::source_loc{}, spdlog_level(level),
             spdlog::string_view_t(message.data(), message.size()));
}

std::optional<std::uint64_t> LogThrottle::pass(const LogLine& line, TimeUs now_us) {
  constexpr TimeUs kPeriodUs = 10'000'000;
  constexpr int kMaxLines = 50;
  Kind& kind = kinds_[{line.file, line.number}];
  if (now_us >= kind.end_us) {
    kind.end_us = now_us + kPeriodUs;
    kind.passed = 0;
  }
  if (kind.passed == kMaxLines) {
    ++kind.omitted;
    return std::nullopt;
  }
  ++kind.passed;
  return std::exchange(kind.omitted, 0);
}

LogSink sink_to(std::shared_ptr<spdlog::logger> logger) {
  struct Shared {
    std::mutex mutex;
    LogThrottle throttle;
  };
  return [logger = std::move(logger), shared = std::make_shared<Shared>()](LogLevel level, const LogLine& line) {
    if (!logger->should_log(spdlog_level(level))) return;
    const std::lock_guard lock(shared->mutex);
    const auto omitted = shared->throttle.pass(line, steady_now_us());
    if (!omitted) return;
    if (*omitted > 0) write_line(*logger, level, std::to_string(*omitted) + " lines like the next one were left out");
    write_line(*logger, level, line);
  };
}

}  // namespace eigencast
