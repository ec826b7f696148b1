// SPDX-License-Identifier: MIT
#include "broker/relay/reader_watch.h"

#include <algorithm>

namespace eigencast::broker {
namespace {

/// A few poses that the peer has yet to read narrow its window by less.
constexpr std::uint32_t kNarrowedBytes = 2048;
/// Slack of the answer beyond the round trip. A wrong hold costs a pose or two.
constexpr TimeUs kPatienceUs = 20'000;

}  // namespace

bool ReaderWatch::note_window(std::uint32_t bytes, TimeUs round_trip_us, TimeUs now_us) {
  latest_ = bytes;
  widest_ = std::max(widest_, bytes);
  if (widest_ - bytes < kNarrowedBytes) {
    hold_from_us_ = kNever;
    return false;
  }
  if (!is_probing()) {
    ++probe_;
    hold_from_us_ = now_us + round_trip_us + kPatienceUs;
  }
  return true;
}

bool ReaderWatch::note_pong(std::string_view payload) {
  if (!is_probing() || payload != probe()) return false;
  hold_from_us_ = kNever;
  widest_ = latest_;  // It reads, so this is its full window.
  return true;
}

}  // namespace eigencast::broker
