// SPDX-License-Identifier: MIT
#include "client/stream_capture.h"

#include <algorithm>
#include <utility>

namespace eigencast {

bool has_whole_surface(const PoseSource& source) {
  const Subscriber::Stats stats = source.stats();
  return source.asset() != nullptr && source.asset()->complete() &&
         stats.asset_bytes_downloaded + stats.asset_bytes_cached >= stats.asset_bytes_total;
}

bool StreamCapture::has_surface() const {
  return has_whole_surface(source_);
}

bool StreamCapture::is_lost() const {
  const Subscriber::State state = source_.stats().state;
  return state != Subscriber::State::kLive && state != Subscriber::State::kDownloading;
}

void StreamCapture::begin() {
  if (frames_.size() < 2) return;
  frames_.erase(frames_.begin(), frames_.end() - 1);
  times_us_.erase(times_us_.begin(), times_us_.end() - 1);
  utc_us_.erase(utc_us_.begin(), utc_us_.end() - 1);
  bytes_ = frames_.front().size() * sizeof(double);
}

Result<void> StreamCapture::take(std::chrono::milliseconds timeout) {
  const std::vector<ReceivedPose> poses = source_.poll(timeout);
  if (!has_surface()) return {};
  for (const ReceivedPose& pose : poses) {
    if (pose.envelope.kind == FrameKind::kEstimate) continue;
    const TimeUs time_us = pose.envelope.capture_us;
    // A sender that comes back is another epoch, and may have set its clock.
    if (info_ && source_.info() && source_.info()->epoch != info_->epoch) {
      if (source_.info()->asset != info_->asset || pose.coefficients.size() != frames_.back().size())
        return fail(ErrorCode::kUnsupported, info_->stream + ": the sender came back with another surface");
      info_->epoch = source_.info()->epoch;
    }
    if (!times_us_.empty() && time_us <= times_us_.back()) continue;
    if (pose.channels < 3 || pose.coefficients.size() != std::size_t{source_.asset()->rank} * pose.channels) continue;
    if (!info_) info_ = source_.info();
    if (!frames_.empty() && pose.coefficients.size() != frames_.back().size()) continue;
    bytes_ += pose.coefficients.size() * sizeof(double);
    if (bytes_ > kMaxBytes)
      return fail(ErrorCode::kTooLarge, "over 1 GiB of coefficients; take a shorter film, or record at the broker");
    frames_.emplace_back(pose.coefficients.begin(), pose.coefficients.end());
    times_us_.push_back(time_us);
    utc_us_.push_back(source_.utc_us(time_us));
  }
  return {};
}

std::shared_ptr<const BakedClip> StreamCapture::clip() {
  auto clip = std::make_shared<BakedClip>();
  clip->asset = *source_.asset();
  clip->info = info_;
  if (info_) {
    clip->name = info_->stream;
    clip->asset_id = info_->asset;
    clip->rate_hz = info_->key_rate_hz;
  }
  clip->frames = std::exchange(frames_, {});
  clip->times_us = std::exchange(times_us_, {});
  clip->utc_us = std::exchange(utc_us_, {});
  const TimeUs first_us = clip->times_us.front();
  for (TimeUs& time_us : clip->times_us) time_us -= first_us;
  clip->period_us = clip->times_us.back() + 1;
  return clip;
}

}  // namespace eigencast
