// SPDX-License-Identifier: MIT
#include "broker/relay/reader_watch.h"

#include <algorithm>

namespace eigencast::broker {
namespace {

/// Slack of the answer beyond the round trip. A wrong hold costs a pose or two.
constexpr TimeUs kPatienceUs = 20'000;
/// Kernels acknowledge up to 200 ms late, as the ping that was sent when frames began to wait.
constexpr TimeUs kCheckUs = 50'000, kSoonUs = 500'000;
constexpr TimeUs kAskUs = 900'000;

}  // namespace

bool ReaderWatch::note_window(std::uint32_t bytes, TimeUs round_trip_us, TimeUs now_us) {
  latest_ = bytes;
  widest_ = std::max(widest_, bytes);
  const std::uint32_t narrowed = widest_ - bytes;
  const bool widens = is_probing() && narrowed + kNarrowedBytes <= narrowed_;
  if (narrowed < slack_ || widens) {
    if (is_probing() && now_us < hold_from_us_ + round_trip_us + kSoonUs)
      slack_ = std::max(slack_, std::min({2 * slack_, narrowed_ + kNarrowedBytes, widest_ / 2}));
    if (widens) widest_ = bytes;  // It reads, and may offer no more than this.
    hold_from_us_ = kNever;
    return false;
  }
  narrowed_ = is_probing() ? std::max(narrowed_, narrowed) : narrowed;
  check_us_ = now_us + kCheckUs;
  if (!is_probing()) {
    ++probe_;
    check_us_ = ask_us_ = hold_from_us_ = now_us + round_trip_us + kPatienceUs;
    end_us_ = now_us + patience_us_;
    return true;
  }
  if (now_us >= end_us_ && !answers_) {
    patience_us_ *= 2;
    slack_ = std::max(slack_, std::min(2 * slack_, bytes / 2));
    widest_ = bytes;
    hold_from_us_ = kNever;
    return false;
  }
  if (now_us < ask_us_) return false;
  ask_us_ = now_us + kAskUs;
  return true;
}

bool ReaderWatch::note_pong(std::string_view payload) {
  if (!is_probing() || payload != probe()) return false;
  answers_ = true;
  hold_from_us_ = kNever;
  widest_ = latest_;  // It reads, so this is its full window.
  return true;
}

}  // namespace eigencast::broker
