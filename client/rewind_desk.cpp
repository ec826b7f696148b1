// SPDX-License-Identifier: MIT
#include "client/rewind_desk.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>

#include "client/clip_player.h"
#include "client/hud_text.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

constexpr TimeUs kSeekEveryUs = 50'000;
constexpr TimeUs kAskEveryUs = 1'000'000;  ///< What is kept, for the bar.
constexpr TimeUs kAnswerUs = 3'000'000;    ///< Then none comes.
constexpr TimeUs kLiveUs = 1'200'000;      ///< The broker shows live what is a second old.
constexpr TimeUs kNearUs = 3'000'000;      ///< So near to it the broker has gone live; else the connection is new.
constexpr TimeUs kLedEveryUs = 2'000'000;
constexpr TimeUs kLedWithinUs = 500'000;  ///< Followers who play need not be nearer.

bool has_past(PoseSource* source) {
  const auto kept = source->rewind() != nullptr ? source->rewind()->kept() : std::nullopt;
  return kept && !kept->spans.empty();
}

const SurfaceView* view_of(const Scene& scene, std::size_t source) {
  const auto& all = scene.instances();
  const auto at = std::find_if(all.begin(), all.end(), [&](const auto& one) { return one.placement.source == source; });
  return at == all.end() ? nullptr : &at->view;
}

/// The capture time of what is shown of a stream's present epoch.
std::optional<TimeUs> shown_of(const PoseSource& source, const SurfaceView* view) {
  const bool is_new = source.info() && source.epoch() == source.info()->epoch;
  return view != nullptr && is_new ? view->shown_capture_us() : std::nullopt;
}

/// Of a rewound stream; nothing: it is live.
std::optional<TimeUs> past_of(const PoseSource& source, const SurfaceView* view) {
  if (!source.info() || !source.info()->rewind) return std::nullopt;
  const auto& rewind = *source.info()->rewind;
  return moment_of(rewind, shown_of(source, view).value_or(rewind.capture_us));
}

}  // namespace

void RewindDesk::begin(double ago_s, double speed) {
  begin_ = ago_s;
  motion_ = {speed == 0, speed == 0 ? 1 : speed};
  changed_ = motion_;
}

void RewindDesk::go(TimeUs at_us) {
  if (motion_.told() >= 1 && at_us > edge_us_ - kLiveUs) {
    present_wanted_ |= is_past_;
    return end();
  }
  is_past_ = true;
  present_wanted_ = false;
  at_us_ = at_us;
  wanted_ = Wanted{at_us, motion_.told()};
}

void RewindDesk::end() {
  is_past_ = holds_ = false;
  steps_ = 0;
  wanted_.reset();
  asked_.reset();
  sought_us_.reset();
  motion_ = {};
  changed_ = motion_;
}

bool RewindDesk::take(ViewerState& state) {
  if (changed_) {
    state.paused = changed_->paused;
    state.speed = changed_->speed;
    changed_.reset();
  }
  if (!bar_) {
    asks_why_ |= state.steps != 0;
    return false;
  }
  const bool to_live = std::exchange(state.live_wanted, false);
  const int steps = std::exchange(state.steps, 0);
  const auto seek_us = std::exchange(state.seek_us, std::nullopt);
  state.speed = std::clamp(state.speed, 1 / limits::kMaxSpeed, is_past_ ? limits::kMaxSpeed : 1.0);
  const Motion before = std::exchange(motion_, Motion{state.paused, state.speed});
  const bool halts = motion_.paused && !before.paused;
  const bool plays = !motion_.paused && (before.paused || before.speed != motion_.speed);
  if (to_live) {
    present_wanted_ |= is_past_;
    end();
  } else if (seek_us) {
    holds_ = false;
    steps_ = 0;
    go(*seek_us);
  } else if (steps != 0) {
    state.paused = motion_.paused = true;
    holds_ = false;
    is_past_ = true;
    steps_ += steps;
  } else if (halts) {
    holds_ = true;
    if (is_past_) go(at_us_);
  } else if (plays) {
    holds_ = false;
    go(at_us_);
  }
  return to_live || seek_us || steps != 0 || halts || plays;
}

void RewindDesk::advance(std::span<PoseSource* const> sources, const Scene& scene, TimeUs now_us) {
  bar_.reset();
  const auto lead = std::find_if(sources.begin(), sources.end(), has_past);
  if (lead == sources.end() || leading_timeline(sources) != nullptr) return ask_why(sources, now_us);
  PoseSource& source = **lead;
  const Rewind::Kept kept = *source.rewind()->kept();
  edge_us_ = kept.now_at(now_us);
  hear(source, kept, now_us);
  const SurfaceView* view = view_of(scene, static_cast<std::size_t>(lead - sources.begin()));
  if (begin_) {
    notice_ = text_from_short_past(kept, edge_us_, *begin_);
    go(edge_us_ - std::llround(1e6 * *std::exchange(begin_, std::nullopt)));
  }
  const bool is_on_its_way = wanted_ || asked_;
  if (!is_past_ && !motion_.paused) at_us_ = edge_us_ - (view != nullptr ? view->playout().delay_us() : 0);
  if (is_past_ && !is_on_its_way && !holds_) at_us_ = past_of(source, view).value_or(at_us_);
  if (steps_ != 0 && !is_on_its_way) {
    wanted_ = steps_ < 0 ? Wanted{at_us_ - 1, 0} : Wanted{at_us_, 0, true};
    steps_ += steps_ < 0 ? 1 : -1;
  }
  send(sources, source, kept, now_us);
  const bool is_behind = is_past_ || motion_.paused;
  bar_ = Bar{kept.spans, edge_us_, is_behind ? at_us_ : edge_us_, is_behind};
  if (!bar_->is_past) led_ = {};
  if (bar_->is_past && (sent_us_ == now_us || now_us - led_us_ >= kLedEveryUs)) {
    led_ = {at_us_, motion_.told()};
    led_us_ = now_us;
  }
}

void RewindDesk::hear(const PoseSource& source, const Rewind::Kept& kept, TimeUs now_us) {
  if (!source.info()) return;
  const bool shows_past = source.info()->rewind.has_value();
  if (asked_ && kept.refusals != asked_->refusals) {
    trouble_ = kept.trouble;
    if (!shows_past) return end();
    asked_.reset();
  }
  const bool waits = asked_ && source.info()->epoch == asked_->epoch && now_us - sent_us_ < kAnswerUs;
  if (waits || wanted_) return;
  const bool was_asked = std::exchange(asked_, std::nullopt).has_value();
  if (!is_past_ || shows_past || steps_ != 0) return;
  if (was_asked || edge_us_ - at_us_ < kNearUs) return end();
  go(at_us_);
}

void RewindDesk::send(std::span<PoseSource* const> sources, const PoseSource& lead, const Rewind::Kept& kept,
                      TimeUs now_us) {
  const auto each = [&](const auto& call) {
    for (PoseSource* source : sources) {
      if (has_past(source)) call(*source->rewind());
    }
  };
  if (now_us - asked_kept_us_ >= kAskEveryUs) {
    asked_kept_us_ = now_us;
    each([](Rewind& rewind) { rewind.ask_kept(); });
  }
  if (std::exchange(present_wanted_, false)) return each([](Rewind& rewind) { rewind.show_present(); });
  if (!wanted_ || !lead.info() || now_us - sent_us_ < kSeekEveryUs) return;
  sent_us_ = now_us;
  each([&](Rewind& rewind) { rewind.seek(std::max<TimeUs>(0, wanted_->at_us), wanted_->speed, wanted_->next); });
  asked_ = Asked{lead.info()->epoch, kept.refusals};
  if (!sought_us_) sought_us_ = now_us;
  wanted_.reset();
}

std::optional<TimeUs> RewindDesk::take_sought(std::span<PoseSource* const> sources, const Scene& scene) {
  const auto lead = std::find_if(sources.begin(), sources.end(), has_past);
  if (!sought_us_ || wanted_ || asked_ || lead == sources.end()) return std::nullopt;
  const auto index = static_cast<std::size_t>(lead - sources.begin());
  return shown_of(**lead, view_of(scene, index)) ? std::exchange(sought_us_, std::nullopt) : std::nullopt;
}

/// Of streams without a past: of which it begins, and for who wants to see it.
void RewindDesk::ask_why(std::span<PoseSource* const> sources, TimeUs now_us) {
  for (PoseSource* source : sources) {
    Rewind* rewind = source->rewind();
    if (rewind == nullptr) continue;
    const auto kept = rewind->kept();
    const bool begins = kept && kept->trouble.empty();
    if (!begins && !asks_why_ && !begin_) continue;
    if (kept && !kept->trouble.empty()) {
      trouble_ = kept->trouble;
      asks_why_ = false;
      begin_.reset();
      return;
    }
    if (now_us - asked_kept_us_ < kAskEveryUs) return;
    asked_kept_us_ = now_us;
    rewind->ask_kept();
  }
}

void RewindDesk::follow(const Led& led) {
  assert(bar_);
  if (!led.at_us) {
    if (!is_past_ && !motion_.paused) return;
    present_wanted_ |= is_past_;
    return end();
  }
  const bool is_there =
      is_past_ && motion_.told() == led.speed && std::abs(*led.at_us - at_us_) <= (led.speed == 0 ? 0 : kLedWithinUs);
  if (is_there) return;
  motion_ = {led.speed == 0, led.speed == 0 ? motion_.speed : led.speed};
  changed_ = motion_;
  holds_ = false;
  go(*led.at_us);
}

}  // namespace eigencast
