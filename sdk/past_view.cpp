// SPDX-License-Identifier: MIT
#include "sdk/past_view.h"

#include <algorithm>
#include <cmath>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

constexpr TimeUs kAskEveryUs = 1'000'000;
constexpr TimeUs kLiveUs = 1'200'000;  ///< The broker shows live what is a second old.

}  // namespace

Result<void> PastView::seek(TimeUs at_us, double speed, bool next) {
  if (!(speed == 0 || (speed >= 1 / limits::kMaxSpeed && speed <= limits::kMaxSpeed)))
    return fail(ErrorCode::kInvalidArgument, "the speed of a seek is 0, or 0.1 to 10");
  if (std::abs(std::max(at_us, -limits::kMaxTimeUs)) > limits::kMaxTimeUs)
    return fail(ErrorCode::kInvalidArgument, "the time of a seek is in microseconds since 1970");
  wanted_ = Wanted{false, at_us, speed, next};
  asked_.reset();
  begins_.reset();
  return {};
}

void PastView::show_present() {
  wanted_ = Wanted{true};
  asked_.reset();
  begins_.reset();
}

Result<void> PastView::advance(Subscriber& subscriber, TimeUs now_us) {
  if (!wanted_ || !subscriber.info()) return {};
  if (asked_) {
    if (const Result<void> heard = hear(subscriber); !heard || !wanted_) return heard;
    if (asked_ && now_us - asked_->at_us < kAnswerUs) return {};
  }
  const auto known = kept(subscriber, now_us);
  if (!wanted_->present && !known) return {};
  if (!wanted_->present && known->spans.empty() && !known->trouble.empty()) {
    wanted_.reset();
    return fail(ErrorCode::kRefused, known->trouble);
  }
  TimeUs at_us = wanted_->at_us;
  if (known && at_us < 0) at_us = std::max<TimeUs>(0, known->now_at(now_us) + at_us);
  if (!wanted_->present) wanted_->present = wanted_->speed >= 1 && at_us > known->now_at(now_us) - kLiveUs;
  asked_ = Asked{now_us, subscriber.info()->epoch, known ? known->refusals : 0, subscriber.stats().reconnects};
  if (!wanted_->present) {
    subscriber.seek(at_us, wanted_->speed, wanted_->next);
  } else if (subscriber.info()->rewind) {
    subscriber.show_present();
  } else {
    wanted_.reset();
    asked_.reset();
  }
  return {};
}

Result<void> PastView::hear(Subscriber& subscriber) {
  const auto known = subscriber.kept();
  if (subscriber.stats().reconnects != asked_->reconnects) {
    asked_.reset();
  } else if (known && known->refusals != asked_->refusals) {
    asked_.reset();
    wanted_.reset();
    return fail(ErrorCode::kRefused, known->trouble);
  } else if (wanted_->present ? !subscriber.info()->rewind : subscriber.info()->epoch != asked_->epoch) {
    begins_ = subscriber.info()->epoch;
    asked_.reset();
    wanted_.reset();
  }
  return {};
}

bool PastView::is_wanted(std::uint32_t epoch, const Subscriber& subscriber) {
  if (wanted_) return false;
  const auto& info = subscriber.info();
  if (begins_ && (epoch == *begins_ || !info || info->epoch != *begins_)) begins_.reset();
  return !begins_;
}

std::optional<Rewind::Kept> PastView::kept(Subscriber& subscriber, TimeUs now_us) {
  if (!asked_kept_us_ || now_us - *asked_kept_us_ >= kAskEveryUs) {
    asked_kept_us_ = now_us;
    subscriber.ask_kept();
  }
  return subscriber.kept();
}

}  // namespace eigencast
