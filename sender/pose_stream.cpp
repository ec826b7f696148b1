// SPDX-License-Identifier: MIT
#include "sender/pose_stream.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace eigencast {
namespace {

static_assert(std::endian::native == std::endian::little, "poses are copied as they are in the stream");

constexpr char kMagic[] = "ECPOSES1";
constexpr std::size_t kMagicBytes = 8;
constexpr std::size_t kHeaderBytes = 16;
constexpr std::uint32_t kTimedFlag = 1;

template <typename T>
T value_at(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

}  // namespace

PoseStream::PoseStream(std::size_t vertices) : vertices_(vertices), positions_(3 * vertices) {
  buffer_.resize(std::max(pose_bytes() + sizeof(double), kHeaderBytes));
}

std::span<char> PoseStream::room() {
  if (done_) filled_ = 0;
  done_ = false;
  const std::size_t whole = phase_ == Phase::kStart    ? kMagicBytes
                            : phase_ == Phase::kHeader ? kHeaderBytes
                                                       : pose_bytes();
  return std::span<char>(buffer_).subspan(filled_, whole - filled_);
}

Result<bool> PoseStream::filled(std::size_t bytes) {
  filled_ += bytes;
  if (phase_ == Phase::kStart && filled_ == kMagicBytes) {
    phase_ = std::memcmp(buffer_.data(), kMagic, kMagicBytes) == 0 ? Phase::kHeader : Phase::kPose;
  }
  if (phase_ == Phase::kHeader && filled_ == kHeaderBytes) {
    const auto flags = value_at<std::uint32_t>(buffer_.data() + kMagicBytes);
    const auto vertices = value_at<std::uint32_t>(buffer_.data() + kMagicBytes + 4);
    if ((flags & ~kTimedFlag) != 0)
      return fail(ErrorCode::kUnsupported, "the poses' header has flags that this version does not know");
    if (vertices != vertices_) {
      return fail(ErrorCode::kInvalidArgument,
                  "the poses have " + std::to_string(vertices) + " vertices, the mesh " + std::to_string(vertices_));
    }
    timed_ = flags != 0;
    phase_ = Phase::kPose;
    filled_ = 0;
  }
  if (phase_ != Phase::kPose || filled_ < pose_bytes()) return false;
  const char* at = buffer_.data();
  if (timed_) {
    time_s_ = value_at<double>(at);
    at += sizeof(double);
  }
  std::memcpy(positions_.data(), at, positions_.size() * sizeof(float));
  done_ = true;
  ++count_;
  return true;
}

Result<TimeUs> PipePace::due_us(TimeUs arrival_us, std::optional<double> time_s) {
  const bool first = poses_ == 0;
  const bool planned = rate_hz_ > 0 || time_s.has_value();
  double offset_s = static_cast<double>(poses_) / (rate_hz_ > 0 ? rate_hz_ : 1);
  if (time_s) {
    const bool sound = std::isfinite(*time_s) && std::abs(*time_s) < 1e9 && (first || *time_s > last_s_);
    if (!sound) {
      return fail(ErrorCode::kCorrupt, "pose " + std::to_string(poses_) + ": its time, " + std::to_string(*time_s) +
                                           " s, is not after " + std::to_string(last_s_) + " s");
    }
    if (first) first_s_ = *time_s;
    last_s_ = *time_s;
    if (rate_hz_ <= 0) offset_s = *time_s - first_s_;
  }
  if (first) anchor_us_ = arrival_us;
  ++poses_;
  TimeUs due_us = planned ? anchor_us_ + std::llround(offset_s * 1e6) : arrival_us;
  if (arrival_us > due_us + kPatienceUs) {
    anchor_us_ += arrival_us - due_us;
    due_us = arrival_us;
    ++restarts_;
  }
  last_us_ = first ? due_us : std::max(due_us, last_us_ + 1);
  return last_us_;
}

TimeUs Schedule::due_us(std::uint64_t tick) const {
  return start_us_ + static_cast<TimeUs>(std::llround(static_cast<double>(tick) * 1e6 / options_.rate_hz));
}

std::optional<Schedule::Tick> Schedule::next(TimeUs now_us) {
  // The newest tick that is due is the one to send; those before it are too late to be worth anything.
  while (due_us(tick_ + 1) <= now_us) {
    ++tick_;
    ++skipped_;
  }
  if (options_.max_ticks > 0 && tick_ >= options_.max_ticks) return std::nullopt;
  const double position = static_cast<double>(tick_) * options_.speed * options_.clip_rate_hz / options_.rate_hz;
  auto frame = static_cast<std::uint64_t>(position + 1e-6);
  if (frame >= options_.frames) {
    if (!options_.loop) return std::nullopt;
    frame %= options_.frames;
  }
  return Tick{due_us(tick_++), static_cast<std::size_t>(frame)};
}

}  // namespace eigencast
