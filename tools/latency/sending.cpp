// SPDX-License-Identifier: MIT
#include "tools/latency/sending.h"

#include <time.h>

#include <algorithm>
#include <cerrno>

#include "common/core/clock.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"

namespace eigencast::latency {
namespace {

constexpr std::size_t kMaxPoses = 240;

/// A thread that sleeps wakes late; so long before a pose is due it is awake and watches the clock.
constexpr TimeUs kAwakeBeforeUs = 150;

void wait_until(TimeUs time_us) {
  const TimeUs awake_us = time_us - kAwakeBeforeUs;
  const timespec until{awake_us / 1'000'000, (awake_us % 1'000'000) * 1000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  while (steady_now_us() < time_us) {
  }
}

}  // namespace

Result<std::unique_ptr<Sending>> Sending::create(const Inputs& inputs, const LogSink& log) {
  auto clip = builtin_clip(inputs.source, std::clamp(inputs.rate_hz, 1.0, 1000.0));
  if (!clip) return clip.error();
  BakeOptions bake_options;
  bake_options.rank = inputs.rank;
  auto baked = bake((*clip)->rest(), bake_options, default_cache_dir());
  if (!baked) return baked.error();
  std::unique_ptr<Sending> made(new Sending(inputs));
  for (std::size_t i = 0; i < std::min((*clip)->frame_count(), kMaxPoses); ++i) {
    const auto pose = (*clip)->pose(i);
    if (!pose) return pose.error();
    auto& flat = made->poses_.emplace_back();
    for (const Vec3& v : *pose)
      for (const double x : v) flat.push_back(static_cast<float>(x));
  }
  const auto codec = codec_from_name(inputs.codec);
  if (!codec) return codec.error();
  PublisherOptions options;
  options.url = inputs.url;
  options.codec = *codec;
  options.key_rate_hz = inputs.rate_hz;
  options.credentials = inputs.credentials;
  auto asset = std::make_shared<const Asset>(std::move(baked->asset));
  auto encoded = std::make_shared<const EncodedAsset>(std::move(baked->encoded));
  auto publisher = Publisher::create(options, std::move(asset), std::move(encoded), log);
  if (!publisher) return publisher.error();
  made->publisher_ = std::move(*publisher);
  return made;
}

Result<void> Sending::wait_until_live(const std::atomic<bool>& stop) const {
  const TimeUs until_us = steady_now_us() + kConnectPatienceUs;
  while (publisher_->stats().state != Publisher::State::kLive) {
    if (stop) return fail(ErrorCode::kCancelled, "interrupted");
    if (publisher_->stats().state == Publisher::State::kRefused)
      return fail(ErrorCode::kRefused, publisher_->stats().detail);
    if (steady_now_us() > until_us)
      return fail(ErrorCode::kTimeout, "the sender is not live: " + publisher_->stats().detail);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return {};
}

void Sending::start() {
  thread_ = std::thread([this] { run(); });
}

void Sending::stop() {
  stopping_ = true;
  if (thread_.joinable()) thread_.join();
}

void Sending::run() {
  sleep_on_time();  // As a sender does.
  run_when_woken(kMakingPoses);
  const TimeUs start_us = steady_now_us() + 1000;
  for (std::uint64_t i = 0; !stopping_; ++i) {
    const TimeUs intended_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i));
    const TimeUs next_us = start_us + static_cast<TimeUs>(interval_us_ * static_cast<double>(i + 1));
    if (steady_now_us() >= next_us) {  // Its time is over: counted, not made up for.
      missed_ += counts(intended_us) ? 1 : 0;
      continue;
    }
    wait_until(intended_us);
    const TimeUs lag_us = steady_now_us() - intended_us;
    const auto status = publisher_->send_positions(poses_[i % poses_.size()], intended_us);
    if (!counts(intended_us)) continue;
    lag_us_.add(lag_us);
    if (status && *status == SendStatus::kSent) {
      ++sent_;
    } else {
      ++dropped_;
    }
  }
}

bool Sending::counts(TimeUs intended_us) const {
  return from_us_ != 0 && intended_us >= from_us_ && (until_us_ == 0 || intended_us < until_us_);
}

}  // namespace eigencast::latency
