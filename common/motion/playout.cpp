// SPDX-License-Identifier: MIT
#include "common/motion/playout.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <utility>

#include "common/motion/curve.h"

namespace eigencast {
namespace {

bool near(const PlayoutPose& a, const PlayoutPose& b) {
  return std::abs(b.time_us - a.time_us) <= PlayoutClock::kLongestSpanUs;
}

PlayoutPose as_it_came(const PlayoutPose& pose, Shown shown) {
  return {pose.time_us, pose.coefficients, pose.bands, shown};
}

}  // namespace

double Correction::remaining(TimeUs now_us) const {
  return std::clamp(1 - static_cast<double>(now_us - since_us_) / kBlendUs, 0.0, 1.0);
}

void Correction::add(std::span<const double> error, TimeUs now_us) {
  const double share = remaining(now_us);
  const bool same_size = error_.size() == error.size();
  if (!same_size) error_.assign(error.size(), 0);
  for (std::size_t i = 0; i < error.size(); ++i) error_[i] = error_[i] * share + error[i];
  since_us_ = now_us;
}

void Correction::apply(std::span<double> pose, TimeUs now_us) const {
  const double share = remaining(now_us);
  if (share == 0 || pose.size() != error_.size()) return;
  for (std::size_t i = 0; i < pose.size(); ++i) pose[i] += share * error_[i];
}

void Correction::replace(const std::function<Coefficients(const Coefficients&)>& carried) {
  if (error_.empty()) return;
  const Coefficients now = carried(error_);
  error_.assign(now.begin(), now.end());
}

Playout::Playout(const PlayoutSettings& settings) : settings_(settings) {
  assert(settings.delay_us >= 0 && settings.max_ahead_us >= 0);
}

void Playout::set(const PlayoutSettings& settings) {
  assert(settings.delay_us >= 0 && settings.max_ahead_us >= 0);
  // The clock follows a new smoothness by itself; a new mode needs a correction.
  settings_changed_ = settings_changed_ || settings.mode != settings_.mode;
  settings_ = settings;
}

double Playout::smoothness() const {
  return std::clamp(settings_.smoothness.value_or(settings_.mode == PlayoutMode::kEstimate ? 0 : 1), 0.0, 1.0);
}

TimeUs Playout::delay_us() const {
  if (settings_.mode == PlayoutMode::kLatest) return 0;
  if (lag_us_) return std::max<TimeUs>(0, *lag_us_ - clock_.fastest_us());
  if (settings_.delay_us > 0) return settings_.delay_us;
  return std::llround(smoothness() * static_cast<double>(clock_.full_delay_us()));
}

std::optional<TimeUs> Playout::needed_lag_us() const {
  if (clock_.longest_delay_us() == 0) return std::nullopt;
  return clock_.fastest_us() + clock_.longest_delay_us();
}

void Playout::replace_poses(const std::function<Coefficients(const Coefficients&)>& carried) {
  for (PlayoutPose& pose : poses_) {
    pose.coefficients = carried(pose.coefficients);
    pose.bands = BandMask(0xff);
  }
  if (!shown_.coefficients.empty()) {
    shown_.coefficients = carried(shown_.coefficients);
    shown_.bands = BandMask(0xff);
  }
  correction_.replace(carried);
}

void Playout::reset() {
  poses_.clear();
  next_ahead_ = false;
  clock_.reset();
  correction_.reset();
  latest_us_.reset();
  shown_at_us_.reset();
  poses_changed_ = settings_changed_ = false;
}

bool Playout::add(PlayoutPose pose, TimeUs arrival_us) {
  pose.time_us = bounded_time(pose.time_us);
  arrival_us = bounded_time(arrival_us);
  const bool sure = pose.shown != Shown::kEstimated;
  if (!poses_.empty() && pose.time_us <= (sure ? newest_sure_us_ : poses_.back().time_us)) return false;
  const std::size_t size = pose.coefficients.size(), before = poses_.empty() ? size : poses_.back().coefficients.size();
  if (size > before) {
    for (PlayoutPose& one : poses_) one.coefficients.edit().resize(size);
  } else if (size < before) {
    poses_.clear();
    next_ahead_ = false;
    correction_.reset();
    shown_at_us_.reset();
  }
  if (sure) {
    drop_estimates();
    clock_.add(pose.time_us, arrival_us);
  }
  if (sure || poses_.empty()) newest_sure_us_ = pose.time_us;
  const bool before_next = next_ahead_ && pose.time_us < poses_.back().time_us;
  if (next_ahead_ && pose.time_us == poses_.back().time_us) poses_.pop_back();
  poses_.insert(poses_.end() - (before_next ? 1 : 0), std::move(pose));
  next_ahead_ = before_next;
  if (poses_.size() > kMaxPoses) poses_.pop_front();
  newest_arrival_us_ = arrival_us;
  poses_changed_ = true;
  return true;
}

void Playout::add_next(PlayoutPose key) {
  key.time_us = bounded_time(key.time_us);
  if (poses_.empty() || key.time_us <= poses_.back().time_us) return;
  if (key.coefficients.size() != poses_.back().coefficients.size() || poses_.back().shown == Shown::kEstimated) return;
  poses_.push_back(std::move(key));
  next_ahead_ = poses_changed_ = true;
}

TimeUs Playout::media_time(TimeUs now_us) {
  const TimeUs newest_us = newest().time_us;
  if (settings_.mode == PlayoutMode::kLatest) {
    // Never back to a key whose estimates have been shown already.
    latest_us_ = std::max(latest_us_.value_or(newest_us), newest_us);
    return *latest_us_;
  }
  if (settings_changed_ && shown_at_us_) clock_.continue_from(*shown_at_us_, now_us);
  return clock_.advance(now_us, delay_us(), lag_us_);
}

std::optional<PlayoutPose> Playout::at(TimeUs now_us) {
  if (poses_.empty() || !clock_.started()) return std::nullopt;
  now_us = bounded_time(now_us);
  if (settings_changed_) latest_us_.reset();
  const TimeUs media_us = media_time(now_us);
  PlayoutPose pose = planned(media_us);
  const bool jumped = settings_.mode != PlayoutMode::kLatest && clock_.jumped();
  if (settings_changed_ || jumped) {
    correct(pose, now_us);
  } else if (poses_changed_ && shown_at_us_ && *shown_at_us_ >= poses_.front().time_us) {
    correct(planned(*shown_at_us_), now_us);
  }
  if (settings_.mode == PlayoutMode::kLatest && now_us - newest_arrival_us_ > kHeldAfterUs) pose.shown = Shown::kHeld;
  poses_changed_ = settings_changed_ = false;
  shown_at_us_ = media_us;
  shown_ = pose;
  pose.settling = correction_.active(now_us);
  if (pose.settling) correction_.apply(pose.coefficients.edit(), now_us);
  return pose;
}

void Playout::correct(const PlayoutPose& right, TimeUs now_us) {
  if (!shown_at_us_ || right.coefficients.size() != shown_.coefficients.size()) return;
  std::vector<double> error(right.coefficients.size());
  bool any = false;
  for (std::size_t i = 0; i < error.size(); ++i) {
    error[i] = shown_.coefficients[i] - right.coefficients[i];
    any = any || error[i] != 0;
  }
  // A band that appears or disappears is not an error; the renderer fades it (docs/protocol.md, section 6).
  const BandMask changed = shown_.bands ^ right.bands;
  const std::size_t channels = band_ends_.empty() ? 0 : error.size() / band_ends_.back();
  for (std::size_t band = 0; band < band_ends_.size(); ++band) {
    if (!changed.has(band)) continue;
    const auto [first, end] = band_range(band_ends_, band, channels);
    std::fill(error.begin() + static_cast<std::ptrdiff_t>(first), error.begin() + static_cast<std::ptrdiff_t>(end),
              0.0);
  }
  if (any) correction_.add(error, now_us);
}

PlayoutPose Playout::planned(TimeUs media_us) const {
  if (settings_.mode == PlayoutMode::kLatest && media_us == newest().time_us) return newest();
  if (media_us >= poses_.back().time_us) return beyond_newest(media_us);
  const auto is_before = [](TimeUs t, const PlayoutPose& pose) { return t < pose.time_us; };
  const auto after = std::upper_bound(poses_.begin(), poses_.end(), media_us, is_before);
  if (after == poses_.begin()) return as_it_came(poses_.front(), Shown::kHeld);
  return between(static_cast<std::size_t>(after - poses_.begin()), media_us);
}

PlayoutPose Playout::between(std::size_t to_index, TimeUs media_us) const {
  const PlayoutPose &from = poses_[to_index - 1], &to = poses_[to_index];
  const BandMask bands = from.bands & to.bands;
  const auto usable = [&](const PlayoutPose& neighbour, const PlayoutPose& beside) {
    return near(neighbour, beside) && near(from, to) && neighbour.bands.includes(bands) &&
           neighbour.shown != Shown::kEstimated && to.shown != Shown::kEstimated;
  };
  const PlayoutPose* before = to_index >= 2 && usable(poses_[to_index - 2], from) ? &poses_[to_index - 2] : nullptr;
  const PlayoutPose* after =
      to_index + 1 < poses_.size() && usable(poses_[to_index + 1], to) ? &poses_[to_index + 1] : nullptr;
  const CurveWeights w =
      catmull_rom_weights(before != nullptr ? std::optional(before->time_us) : std::nullopt, from.time_us, to.time_us,
                          after != nullptr ? std::optional(after->time_us) : std::nullopt, media_us);
  const std::array<Term, 4> terms{{{&from, w.from}, {&to, w.to}, {before, w.before}, {after, w.after}}};
  PlayoutPose pose = mixed(terms, bands, from, to);
  pose.time_us = media_us;
  pose.shown = to.shown == Shown::kEstimated ? Shown::kEstimated : Shown::kInterpolated;
  return pose;
}

PlayoutPose Playout::beyond_newest(TimeUs media_us) const {
  const PlayoutPose& newest = poses_.back();
  const bool directed = poses_.size() > 1 && near(poses_[poses_.size() - 2], newest);
  if (settings_.mode == PlayoutMode::kInterpolate || !directed) return as_it_came(newest, Shown::kHeld);
  const PlayoutPose& older = poses_[poses_.size() - 2];
  const TimeUs end_us = std::max(newest.time_us, newest_sure_us_ + settings_.max_ahead_us);
  const TimeUs ahead_us = std::min(media_us, end_us) - newest.time_us;
  const double span_us = static_cast<double>(newest.time_us - older.time_us);
  const double steps = damped_steps(static_cast<double>(ahead_us) / span_us, kDamping);
  const std::array<Term, 2> terms{{{&newest, 1 + steps}, {&older, -steps}}};
  PlayoutPose pose = mixed(terms, newest.bands & older.bands, newest, newest);
  pose.bands = newest.bands;
  pose.time_us = newest.time_us + ahead_us;
  pose.shown = media_us > end_us ? Shown::kHeld : Shown::kEstimated;
  return pose;
}

// The weighted sum in `bands`; other bands come from a where a lacks them, else from b.
PlayoutPose Playout::mixed(std::span<const Term> terms, BandMask bands, const PlayoutPose& a,
                           const PlayoutPose& b) const {
  PlayoutPose pose;
  pose.bands = bands;
  std::vector<double> sum(a.coefficients.size(), 0);
  for (const Term& term : terms) {
    if (term.pose == nullptr || term.weight == 0) continue;
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += term.weight * term.pose->coefficients[i];
  }
  const std::size_t channels = band_ends_.empty() ? 0 : sum.size() / band_ends_.back();
  for (std::size_t band = 0; band < band_ends_.size(); ++band) {
    if (bands.has(band)) continue;
    const Coefficients& source = (a.bands.has(band) ? b : a).coefficients;
    const auto [first, end] = band_range(band_ends_, band, channels);
    std::copy(source.begin() + first, source.begin() + end, &sum[first]);
  }
  pose.coefficients = std::move(sum);
  return pose;
}

}  // namespace eigencast
