// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "common/core/clock.h"

/// When the poses of a program go out, and which of them. Pure: time comes in as an argument.
namespace eigencast {

/// Poses that wait to go out. Those that the rate has room for go at once, in order; of those beyond it the newest
/// waits for its turn. Not thread-safe.
template <typename Pose>
class PacedQueue {
 public:
  static constexpr double kBurst = 4;          ///< Poses that may come together: programs are never quite even.
  static constexpr std::size_t kLongest = 16;  ///< More: the oldest goes.

  /// max_rate_hz  > 0; may be infinite
  explicit PacedQueue(double max_rate_hz) : interval_us_(1e6 / max_rate_hz) {}

  /// A pose that did not go out for it.
  std::optional<Pose> add(Pose pose, TimeUs now_us) {
    refill(now_us);
    if (last_is_early_ && !pay()) return std::exchange(poses_.back(), std::move(pose));
    last_is_early_ = !pay();
    poses_.push_back(std::move(pose));
    if (poses_.size() <= kLongest) return std::nullopt;
    std::optional<Pose> oldest(std::move(poses_.front()));
    poses_.pop_front();
    return oldest;
  }
  /// Nothing: none waits.
  std::optional<TimeUs> due_us(TimeUs now_us) {
    if (poses_.empty()) return std::nullopt;
    refill(now_us);
    if (poses_.size() > 1 || !last_is_early_ || tokens_ >= 1) return now_us;
    return now_us + static_cast<TimeUs>(std::ceil((1 - tokens_) * interval_us_));
  }
  /// REQUIRES: one waits.
  Pose take(TimeUs now_us) {
    refill(now_us);
    if (poses_.size() == 1 && last_is_early_) {
      tokens_ = std::max(0.0, tokens_ - 1);
      last_is_early_ = false;
    }
    Pose pose = std::move(poses_.front());
    poses_.pop_front();
    return pose;
  }
  std::size_t size() const { return poses_.size(); }
  const Pose& front() const { return poses_.front(); }  ///< REQUIRES: one waits.

 private:
  void refill(TimeUs now_us) {
    if (last_us_) tokens_ = std::min(kBurst, tokens_ + static_cast<double>(now_us - *last_us_) / interval_us_);
    if (interval_us_ <= 0) tokens_ = kBurst;
    last_us_ = now_us;
  }
  bool pay() {
    if (tokens_ < 1) return false;
    --tokens_;
    return true;
  }

  double interval_us_;
  double tokens_ = kBurst;
  std::optional<TimeUs> last_us_;
  bool last_is_early_ = false;  ///< The last pose came before its turn.
  std::deque<Pose> poses_;
};

/// Puts a program's own times on the clock of capture times. Where they drift apart, jump or run back, they are taken
/// up anew at the present. Not thread-safe.
class HostTime {
 public:
  static constexpr TimeUs kPatienceUs = 100'000;

  /// Growing.  time_s  finite
  TimeUs capture_us(TimeUs now_us, std::optional<double> time_s) {
    TimeUs capture = now_us;
    if (time_s) {
      const double offset_us = anchor_s_ ? (*time_s - *anchor_s_) * 1e6 : 0;
      const bool follows = anchor_s_ && *time_s > last_s_ &&
                           std::abs(static_cast<double>(anchor_us_ - now_us) + offset_us) <= double{kPatienceUs};
      if (follows) {
        capture = anchor_us_ + std::llround(offset_us);
      } else {
        anchor_us_ = now_us;
        anchor_s_ = time_s;
      }
      last_s_ = *time_s;
    }
    last_us_ = std::max(capture, last_us_ + 1);
    return last_us_;
  }
  /// The next one is later than this.
  void pass(TimeUs capture_us) { last_us_ = std::max(last_us_, capture_us); }

 private:
  TimeUs last_us_ = -1, anchor_us_ = 0;
  std::optional<double> anchor_s_;
  double last_s_ = 0;
};

}  // namespace eigencast
