// SPDX-License-Identifier: MIT
#include "broker/sockets/newcomer_time.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace eigencast::broker {
namespace {

constexpr double kPart = 0.5;        ///< Of the loop's time.
constexpr double kAtOnceUs = 5'000;  ///< Taken ahead of it after a rest.

}  // namespace

bool NewcomerTime::is_free(TimeUs now_us) const {
  return paid_until_us_ <= static_cast<double>(now_us) + kAtOnceUs;
}

bool NewcomerTime::take(const std::string& holder, double us, TimeUs wait_us, std::function<void()> then) {
  const TimeUs now_us = steady_now_us();
  if (wait_us <= 0 && waiting_.empty() && is_free(now_us)) {
    paid_until_us_ = std::max(paid_until_us_, static_cast<double>(now_us)) + us / kPart;
    return true;
  }
  Work work{holder, us, std::move(then)};
  wait_us <= 0 ? wait(std::move(work)) : void(later_.emplace(now_us + wait_us, std::move(work)));
  arm();
  return false;
}

void NewcomerTime::wait(Work work) {
  const std::string holder = work.holder;
  waiting_.push(holder, static_cast<std::int64_t>(std::ceil(work.us)), std::move(work));
}

void NewcomerTime::arm() {
  if (waiting_.empty() && later_.empty()) return;
  TimeUs next_us = later_.empty() ? std::numeric_limits<TimeUs>::max() : later_.begin()->first;
  if (!waiting_.empty()) next_us = std::min(next_us, static_cast<TimeUs>(std::ceil(paid_until_us_ - kAtOnceUs)));
  if (armed_us_ != 0 && armed_us_ <= next_us) return;
  armed_us_ = next_us;
  timer_.expires_at(std::chrono::steady_clock::time_point(std::chrono::microseconds(next_us)));
  timer_.async_wait([this](ErrorOf error) {
    if (!error) serve();
  });
}

void NewcomerTime::serve() {
  armed_us_ = 0;
  const TimeUs now_us = steady_now_us();
  while (!later_.empty() && later_.begin()->first <= now_us) {
    wait(std::move(later_.extract(later_.begin()).mapped()));
  }
  std::function<void()> then;
  if (!waiting_.empty() && is_free(now_us)) {
    Work work = waiting_.pop().item;
    paid_until_us_ = std::max(paid_until_us_, static_cast<double>(now_us)) + work.us / kPart;
    then = std::move(work.then);
  }
  arm();  // One at a time: streams come between.
  if (then) then();
}

}  // namespace eigencast::broker
