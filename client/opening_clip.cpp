// SPDX-License-Identifier: MIT
#include "client/opening_clip.h"

#include <cstdio>
#include <exception>
#include <utility>

namespace eigencast {

OpeningClip::OpeningClip(std::string input, std::string cache_dir) : detail_("reading " + input) {
  info_.emplace();
  info_->stream = input;
  thread_ = std::thread([this, input = std::move(input), cache_dir = std::move(cache_dir)] { bake(input, cache_dir); });
}

OpeningClip::~OpeningClip() {
  stop_.store(true);
  thread_.join();
}

void OpeningClip::bake(const std::string& input, const std::string& cache_dir) {
  const auto progress = [this](double fraction, std::string_view stage) {
    char percent[16];
    std::snprintf(percent, sizeof percent, " %.0f %%", 100 * fraction);
    const std::lock_guard lock(mutex_);
    detail_ = "preparing: " + std::string(stage) + percent;
    return !stop_.load();
  };
  Result<std::shared_ptr<const BakedClip>> made = fail(ErrorCode::kInternal, input + ": baking ended unexpectedly");
  // An exception that leaves a thread would end the viewer; a surface that is too large for memory is only that surface's end.
  try {
    made = BakedClip::open(input, cache_dir, progress);
  } catch (const std::exception& error) {
    made = fail(ErrorCode::kInternal, input + ": " + error.what());
  }
  const std::lock_guard lock(mutex_);
  made_ = std::move(made);
}

std::vector<ReceivedPose> OpeningClip::poll(std::chrono::milliseconds timeout) {
  if (!playing_ && !failed_) {
    std::optional<Result<std::shared_ptr<const BakedClip>>> made;
    {
      const std::lock_guard lock(mutex_);
      std::swap(made, made_);
    }
    if (made && *made) playing_ = std::make_unique<ClipSource>(std::move(**made));
    if (made && !*made) failed_ = made->error().message;
  }
  if (playing_) return playing_->poll(timeout);
  std::this_thread::sleep_for(timeout);
  return {};
}

Subscriber::Stats OpeningClip::stats() const {
  if (playing_) return playing_->stats();
  Subscriber::Stats stats;
  stats.state = failed_ ? Subscriber::State::kRefused : Subscriber::State::kDownloading;
  const std::lock_guard lock(mutex_);
  stats.detail = failed_.value_or(detail_);
  return stats;
}

}  // namespace eigencast
