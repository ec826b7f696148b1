// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <utility>

#include "common/command_line/log.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr EnumNames<LogLevel, 4> kLevels{{"debug", "info", "warning", "error"}};

/// Replaces control characters, which peers' input may contain: a line stays one line.
std::string one_line(std::string text) {
  for (char& c : text) c = static_cast<unsigned char>(c) < 0x20 || c == 127 ? ' ' : c;
  return text;
}

std::string kind_of(std::string_view line) {
  std::string kind;
  for (const char c : line.substr(0, 160)) {
    const bool digit = c >= '0' && c <= '9';
    if (!digit || kind.empty() || kind.back() != '#') kind += digit ? '#' : c;
  }
  return kind;
}

}  // namespace

std::optional<std::uint64_t> LogThrottle::admit(std::string_view line, TimeUs now_us) {
  std::string key = kind_of(line);
  auto found = kinds_.find(key);
  if (found == kinds_.end()) {
    if (kinds_.size() >= settings_.max_kinds) {
      kinds_.erase(std::min_element(kinds_.begin(), kinds_.end(),
                                    [](const auto& a, const auto& b) { return a.second.last_us < b.second.last_us; }));
    }
    found = kinds_.emplace(std::move(key), Kind{now_us, now_us, 0, 0}).first;
  }
  Kind& kind = found->second;
  kind.last_us = now_us;
  if (now_us - kind.period_start_us >= settings_.period_us) {
    kind.period_start_us = now_us;
    kind.passed = 0;
  }
  if (kind.passed >= settings_.lines) {
    ++kind.omitted;
    return std::nullopt;
  }
  ++kind.passed;
  return std::exchange(kind.omitted, 0);
}

LogSink make_log_sink(const std::string& level, const std::string& format) {
  const bool json = format == "json";
  const LogLevel min_level = kLevels.find(level).value_or(LogLevel::kError);
  struct Shared {
    std::mutex mutex;
    LogThrottle throttle;  // GUARDED_BY(mutex)
  };
  return [sink = sink_to(stderr_logger(min_level, json ? LogFormat::kJson : LogFormat::kText)), json, min_level,
          shared = std::make_shared<Shared>()](LogLevel line_level, std::string_view message) {
    if (line_level < min_level) return;
    std::optional<std::uint64_t> omitted;
    {
      const std::lock_guard lock(shared->mutex);
      omitted = shared->throttle.admit(message, steady_now_us());
    }
    if (!omitted) return;
    std::string text(message);
    if (*omitted > 0) text += " (repeated " + std::to_string(*omitted) + " times meanwhile)";
    constexpr auto kReplace = nlohmann::json::error_handler_t::replace;
    sink(line_level, json ? nlohmann::json(text).dump(-1, ' ', false, kReplace) : one_line(text));
  };
}

}  // namespace eigencast::broker
