// SPDX-License-Identifier: MIT
#include "sdk/send_policy.h"

#include <algorithm>
#include <cmath>

namespace eigencast {
namespace {

constexpr double kAveragingUs = 500'000;
constexpr double kCoarsest = 63;
/// Octaves of spacing per octave of rate and second: doubling the spacing saves about half of the bits.
constexpr double kGainPerSecond = 3;
constexpr TimeUs kBandPauseUs = 2'000'000;
/// A band that has stayed for so long stays; one that had to go before is waited for twice as long, at most so long.
constexpr TimeUs kLongestBandPauseUs = 64'000'000;
/// Bands come back when the spacing is at most this, so that adding one does not take it to its end again.
constexpr double kRoomForABand = 24;

}  // namespace

RateControl::RateControl(double target_bits_per_s, std::uint8_t finest, std::uint8_t bands)
    : target_(target_bits_per_s),
      finest_(finest),
      all_bands_(bands),
      log_spacing_(std::log2(static_cast<double>(finest))),
      bits_per_s_(target_bits_per_s),
      band_pause_us_(kBandPauseUs),
      choice_{finest, bands} {}

void RateControl::add(std::size_t bytes, TimeUs capture_us) {
  if (!last_us_ || capture_us <= *last_us_) {
    last_us_ = capture_us;
    return;
  }
  const double gap_us = static_cast<double>(capture_us - *last_us_);
  last_us_ = capture_us;
  const double weight = 1 - std::exp(-gap_us / kAveragingUs);
  bits_per_s_ += weight * (static_cast<double>(bytes) * 8e6 / gap_us - bits_per_s_);
  const double excess = std::clamp(std::log2(std::max(bits_per_s_, 1.0) / target_), -2.0, 2.0);
  const double seconds = std::min(gap_us * 1e-6, 0.1);
  const double low = std::log2(static_cast<double>(finest_)), high = std::log2(kCoarsest);
  log_spacing_ = std::clamp(log_spacing_ + kGainPerSecond * excess * seconds, low, high);
  choice_.half_spacing = static_cast<std::uint8_t>(std::lround(std::exp2(log_spacing_)));

  const TimeUs since_us = capture_us - bands_changed_us_;
  if (since_us < kBandPauseUs) return;
  if (band_on_trial_ && since_us >= kLongestBandPauseUs) {
    band_on_trial_ = false;
    band_pause_us_ = kBandPauseUs;
  }
  const bool too_much = log_spacing_ >= high && excess > 0 && choice_.bands > 1;
  const bool room = std::exp2(log_spacing_) <= std::max(kRoomForABand, double{1} * finest_) && excess <= 0;
  if (too_much) {
    --choice_.bands;
    if (band_on_trial_) band_pause_us_ = std::min(2 * band_pause_us_, kLongestBandPauseUs);
    band_on_trial_ = false;
  } else if (room && choice_.bands < all_bands_ && since_us >= band_pause_us_) {
    ++choice_.bands;
    band_on_trial_ = true;
  } else {
    return;
  }
  bands_changed_us_ = capture_us;
}

Key lowest_bands(const CoefficientLayout& layout, Key key, std::uint8_t count) {
  key.bands &= BandMask::lowest(count);
  for (std::size_t band = count; band < layout.band_ends.size(); ++band) {
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i) {
      if (!key.q.empty()) key.q[i] = 0;
      if (!key.f.empty()) key.f[i] = 0;
    }
  }
  return key;
}

StillGate::Action StillGate::next(double distance, TimeUs capture_us) {
  if (distance > bound_) {
    const bool paused = state_ == State::kStill && held_until_us_ > sent_us_;
    state_ = State::kMoving;
    return paused ? Action::kResume : Action::kSend;
  }
  const bool due = state_ == State::kMoving || capture_us - sent_us_ >= heartbeat_us_;
  state_ = State::kStill;
  held_until_us_ = capture_us;
  if (!due) return Action::kSkip;
  sent_us_ = capture_us;
  return Action::kHold;
}

}  // namespace eigencast
