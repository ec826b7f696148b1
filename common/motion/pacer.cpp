// SPDX-License-Identifier: MIT
#include "common/motion/pacer.h"

#include <algorithm>
#include <cassert>
#include <limits>

namespace eigencast {
namespace {

constexpr int kLateKeysToRestart = 3;
constexpr TimeUs kNever = std::numeric_limits<TimeUs>::min();

}  // namespace

Pacer::Pacer(std::uint8_t k, TimeUs max_span_us, int further_keys)
    : k_(k), max_span_us_(max_span_us), further_keys_(further_keys), last_due_us_(kNever) {
  assert(k >= 1 && k <= 15 && (further_keys == 0 || further_keys == 1));
  assert(max_span_us > 0);
}

void Pacer::reset() {
  last_.reset();
  delay_us_.reset();
  samples_.clear();
  late_in_a_row_ = 0;
  last_due_us_ = kNever;
  queue_.clear();
}

void Pacer::push(const Due& due) {
  queue_.push_back(due);
  queue_.back().due_us = last_due_us_ = std::max(due.due_us, last_due_us_);
}

void Pacer::restart(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us) {
  dropped_ += queue_.size();
  reset();
  push({sequence, k_, k_, capture_us, arrival_us});
}

void Pacer::add_key(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us) {
  capture_us = bounded_time(capture_us);
  arrival_us = bounded_time(arrival_us);
  // A wait this long means that the clock jumped ahead; nothing would be emitted for the length of the jump.
  const bool too_far_off = delay_us_ && capture_us + *delay_us_ - arrival_us > max_span_us_ * (1 + further_keys_);
  const bool in_order = last_ && sequence > last_->sequence && capture_us > last_->capture_us;
  const bool bridged = in_order && sequence == last_->sequence + 1 && capture_us - last_->capture_us <= max_span_us_;
  if (!in_order || (!bridged && too_far_off)) {
    restart(sequence, capture_us, arrival_us);
  } else if (!bridged) {
    const TimeUs due_us = delay_us_ ? std::max(arrival_us, capture_us + *delay_us_) : arrival_us;
    push({sequence, k_, k_, capture_us, due_us});
  } else {
    bridge(sequence, capture_us, arrival_us);
  }
  last_ = KeyTimes{sequence, capture_us, arrival_us};

  // At most this key interval, the one before it and those of the further keys wait.
  int intervals = 1;
  std::uint64_t oldest = sequence;
  for (auto due = queue_.rbegin(); due != queue_.rend(); ++due) {
    if (due->sequence == oldest) continue;
    if (++intervals > 2 + further_keys_) break;
    oldest = due->sequence;
  }
  while (!queue_.empty() && queue_.front().sequence != sequence && queue_.front().sequence < oldest) {
    queue_.pop_front();
    ++dropped_;
  }
}

void Pacer::bridge(std::uint64_t sequence, TimeUs capture_us, TimeUs arrival_us) {
  const TimeUs span_us = capture_us - last_->capture_us;
  const auto media_us = [&](int at) { return last_->capture_us + span_us * at / k_; };
  const TimeUs before_us = delay_us_.value_or(kNever);
  delay_us_ = delay_from({arrival_us, arrival_us + further_keys_ * span_us - media_us(1), span_us});

  // A smaller delay is reached gradually, so that the poses of this interval stay even; a larger one at once.
  const TimeUs start_us = std::max(before_us, *delay_us_);
  for (int at = 1; at <= k_; ++at) {
    const TimeUs due_us = media_us(at) + start_us + (*delay_us_ - start_us) * at / k_;
    if (at < k_ && due_us + span_us / k_ <= arrival_us) {
      ++dropped_;
    } else {
      push({sequence, static_cast<std::uint8_t>(at), k_, media_us(at), due_us});
    }
  }
}

TimeUs Pacer::delay_from(const Sample& sample) {
  samples_.push_back(sample);
  while (samples_.size() > kMaxArrivals || samples_.front().arrival_us < sample.arrival_us - kWindowUs)
    samples_.pop_front();
  if (!delay_us_) return sample.need_us;

  // Lateness of more than one key interval cannot be waited for: two intervals are all that the queue holds.
  const auto needs_less = [](const Sample& a, const Sample& b) { return a.need_us < b.need_us; };
  const auto is_shorter = [](const Sample& a, const Sample& b) { return a.span_us < b.span_us; };
  const TimeUs min_us = std::min_element(samples_.begin(), samples_.end(), needs_less)->need_us;
  const TimeUs limit_us = min_us + std::min_element(samples_.begin(), samples_.end(), is_shorter)->span_us;
  if (sample.need_us > limit_us) {
    // Keys that wait in a burst come together; keys over a longer way come as far apart as they were made.
    const bool in_burst = 2 * (sample.arrival_us - last_->arrival_us) < sample.span_us;
    late_in_a_row_ = in_burst ? 0 : late_in_a_row_ + 1;
    if (late_in_a_row_ >= kLateKeysToRestart) {
      samples_ = {sample};
      late_in_a_row_ = 0;
      return sample.need_us;
    }
    return std::min(*delay_us_, limit_us);
  }
  late_in_a_row_ = 0;

  TimeUs target_us = min_us;
  for (const Sample& s : samples_) {
    if (s.need_us <= limit_us) target_us = std::max(target_us, s.need_us);
  }
  if (target_us >= *delay_us_) return target_us;
  return std::clamp(*delay_us_ - sample.span_us / kSlew, target_us, limit_us);
}

std::optional<Pacer::Due> Pacer::pop_due(TimeUs now_us) {
  if (queue_.empty() || queue_.front().due_us > now_us) return std::nullopt;
  const Due due = queue_.front();
  queue_.pop_front();
  return due;
}

std::optional<TimeUs> Pacer::next_due_us() const {
  if (queue_.empty()) return std::nullopt;
  return queue_.front().due_us;
}

}  // namespace eigencast
