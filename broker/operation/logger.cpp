// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <poll.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/command_line/log.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr EnumNames<LogLevel, 4> kLevels{{"debug", "info", "warning", "error"}};
constexpr std::size_t kMaxLineBytes = 1024;  ///< So that a pipe that takes anything takes a whole line.

class LogWriter {
 public:
  LogWriter(const Config& config, LogLevel min_level)
      : queue_({config.log.max_lines, config.log.max_queued_bytes}),
        json_(config.log.format == "json"),
        logger_(stderr_logger(min_level, json_ ? LogFormat::kJson : LogFormat::kText)),
        thread_([this] { run(); }) {}
  ~LogWriter() {
    ends_ = true;
    push(LogLevel::kDebug, "");  // Wakes it.
    thread_.join();
  }
  void push(LogLevel level, const LogLine& line) {
    const std::lock_guard lock(mutex_);
    if (!ends_) queue_.push(level, line, steady_now_us());
    changed_.notify_one();
  }

 private:
  void run() {
    constexpr auto kReplace = nlohmann::json::error_handler_t::replace;
    std::unique_lock lock(mutex_);
    for (bool last = false; !last;) {
      changed_.wait_for(lock, std::chrono::seconds(10), [this] { return ends_ || queue_.has_lines(); });
      last = ends_;
      const auto lines = queue_.take(steady_now_us(), last);
      lock.unlock();
      for (const auto& [level, text, time_us] : lines) {
        if (!may_write()) return;
        write_line(*logger_, level, json_ ? nlohmann::json(text).dump(-1, ' ', false, kReplace) : text,
                   std::chrono::microseconds(steady_now_us() - time_us));
      }
      lock.lock();
    }
  }
  /// Waits until standard error takes something; false: not within a second after the end.
  bool may_write() const {
    pollfd out{STDERR_FILENO, POLLOUT, 0};
    for (int waited = 0; waited < 10; waited += ends_ ? 1 : 0) {
      if (::poll(&out, 1, 100) != 0) return true;
    }
    return false;
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  LogQueue queue_;  // GUARDED_BY(mutex_)
  std::atomic<bool> ends_{false};
  const bool json_;
  const std::shared_ptr<spdlog::logger> logger_;
  std::thread thread_;
};

}  // namespace

void LogQueue::push(LogLevel level, const LogLine& line, TimeUs now_us) {
  Kind& kind = kinds_[{line.file, line.number}];
  if (now_us >= kind.end_us && kind.omitted == 0) {
    kind.end_us = now_us + settings_.period_us;
    kind.passed = 0;
  }
  Line kept{level, std::string(line.text.substr(0, kMaxLineBytes)), now_us};
  if (kind.passed >= settings_.max_lines) {
    kind.last = std::move(kept);
    ++kind.omitted;
    return;
  }
  ++kind.passed;
  const auto bytes = static_cast<std::int64_t>(sizeof kept + kept.text.size());
  if (bytes_ + bytes > settings_.max_bytes) {
    ++dropped_;
    return;
  }
  bytes_ += bytes;
  lines_.push_back(std::move(kept));
}

std::vector<LogQueue::Line> LogQueue::take(TimeUs now_us, bool ends) {
  const auto taken = [](std::uint64_t& count) { return std::to_string(std::exchange(count, 0)); };
  std::vector<Line> lines = std::exchange(lines_, {});
  bytes_ = 0;
  if (dropped_ > 0) {
    lines.push_back({LogLevel::kWarning,
                     taken(dropped_) + " lines are missing here: standard error was too slow for log.max_queued_bytes",
                     now_us});
  }
  for (auto& [place, kind] : kinds_) {
    if (kind.omitted == 0 || (now_us < kind.end_us && !ends)) continue;
    lines.push_back({kind.last.level, taken(kind.omitted) + " more lines like this: " + kind.last.text, now_us});
  }
  return lines;
}

LogSink make_log_sink(const Config& config) {
  const LogLevel min_level = kLevels.find(config.log.level).value_or(LogLevel::kError);
  return [min_level, writer = std::make_shared<LogWriter>(config, min_level)](LogLevel level, const LogLine& line) {
    if (level >= min_level) writer->push(level, line);
  };
}

}  // namespace eigencast::broker
