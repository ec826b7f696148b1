// SPDX-License-Identifier: MIT
#include "client/stream_capture.h"

#include <algorithm>
#include <utility>

#include "sdk/transfer.h"

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
  return ended_ || (state != Subscriber::State::kLive && state != Subscriber::State::kDownloading);
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
    const auto& info = source_.info();
    if (info_ && info && info->epoch != info_->epoch && info->epoch == source_.epoch()) {
      if (const auto changed = change_over(*info); !changed) return changed;
    }
    if (ended_) return {};
    if (!times_us_.empty() && time_us <= times_us_.back()) continue;
    if (pose.channels < 3 || pose.coefficients.size() != std::size_t{source_.asset()->rank} * pose.channels) continue;
    if (!info_) {
      info_ = source_.info();
      asset_ = *source_.asset();
    }
    channels_ = pose.channels;
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

Result<void> StreamCapture::change_over(const control::StreamInfo& info) {
  if (info_->rewind.has_value() != info.rewind.has_value()) {
    ended_ = info_->rewind.has_value();
    if (ended_) return {};
    frames_.clear();
    times_us_.clear();
    utc_us_.clear();
    bytes_ = 0;
    info_.reset();
    return {};
  }
  const bool goes_on = info.asset != info_->asset;
  const auto transfer = goes_on ? Transfer::between(asset_, *source_.asset()) : std::nullopt;
  if ((goes_on && !transfer) || info.format.channels != info_->format.channels)
    return fail(ErrorCode::kUnsupported, info_->stream + ": the sender came back with another surface");
  info_ = info;
  if (!transfer) return {};
  asset_ = *source_.asset();
  bytes_ = 0;
  for (std::vector<double>& C : frames_) {
    C = transfer->apply(C, channels_);
    bytes_ += C.size() * sizeof(double);
  }
  return {};
}

std::shared_ptr<const BakedClip> StreamCapture::clip() {
  auto clip = std::make_shared<BakedClip>();
  clip->asset = std::move(asset_);
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
