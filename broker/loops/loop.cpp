// SPDX-License-Identifier: MIT
#include "broker/loops/loop.h"

#include <algorithm>
#include <utility>

#include "broker/connections/connection.h"
#include "common/core/clock.h"

namespace eigencast::broker {
namespace {

// Poses of many streams due within this gap are pumped together.
constexpr TimeUs kMinPumpGapUs = 1000;

Hub::Settings hub_settings(const Config& config, std::vector<StreamTap*> taps, std::shared_ptr<StreamIds> ids,
                           std::function<void(Stream&)> on_opened) {
  Hub::Settings settings;
  settings.max_streams = static_cast<std::size_t>(config.limits.max_streams);
  settings.stream.max_span_us = config.frames.max_span_ms * 1000;
  settings.stream.max_ahead_us = config.frames.max_ahead_ms * 1000;
  settings.stream.max_watchers = static_cast<std::uint32_t>(config.limits.max_subscribers_per_stream);
  settings.stream.max_profiles = static_cast<std::size_t>(config.limits.max_profiles_per_stream);
  settings.stream.taps = std::move(taps);
  settings.ids = std::move(ids);
  settings.on_opened = std::move(on_opened);
  return settings;
}

Turn::Settings turn_settings(const Config& config) {
  Turn::Settings settings;
  settings.gathering.tick_us = config.frames.gather_ms * 1000;
  settings.gathering.above_per_second = static_cast<std::uint64_t>(config.frames.gather_above);
  settings.uring = config.sockets.writes != "epoll";
  return settings;
}

}  // namespace

Loop::Loop(const Config& config, const SharedContext& shared, const Siblings& siblings, std::vector<StreamTap*> taps,
           std::function<void(Stream&)> on_opened)
    : hub_(hub_settings(config, std::move(taps), siblings.ids, std::move(on_opened))),
      context_{shared, io_, config, hub_, turn_, siblings.loops, siblings.last_connection_id},
      io_(1),
      turn_(
          io_, turn_settings(config), shared.log,
          [this] {
            hub_.deliver();
            arm_schedule();
          },
          [this] { hub_.prepare(); }),
      schedule_(io_.get_executor()),
      tick_(io_.get_executor()) {}

void Loop::begin() {
  run_when_woken(kPassingOn);
  turn_.begin();
  context_.started_us = steady_now_us();
  tick();
}

void Loop::run() {
  bool ended = false;
  while (!ended) {
    guarded([&] {
      io_.run();  // A stopped loop returns at once.
      ended = true;
    });
  }
}

void Loop::guarded(const std::function<void()>& work) noexcept {
  try {
    work();
  } catch (const std::exception& exception) {
    log_failure(exception);
  }
}

void Loop::log_failure(const std::exception& exception) noexcept {
  try {
    log(context_.log, LogLevel::kError, std::string("a request was given up, the broker goes on: ") + exception.what());
  } catch (const std::exception&) {  // No memory for the line.
  }
}

void Loop::arm_schedule() {
  const auto due = hub_.next_due_us();
  if (!due || (scheduled_us_ && *scheduled_us_ <= *due)) return;
  scheduled_us_ = due;
  const TimeUs at_us = std::max(*due, pumped_us_ + kMinPumpGapUs);
  schedule_.expires_at(std::chrono::steady_clock::time_point(std::chrono::microseconds(at_us)));
  schedule_.async_wait([this](ErrorOf error) {
    if (error) return;
    scheduled_us_.reset();
    pumped_us_ = steady_now_us();
    guarded([this] { hub_.pump(pumped_us_); });
    arm_schedule();
  });
}

void Loop::tick() {
  run_after(tick_, std::chrono::seconds(1), [this] { tick(); });
  for (Connection* connection : context_.connections) connection->tick();
}

}  // namespace eigencast::broker
