// SPDX-License-Identifier: MIT
#include "broker/sockets/loop_share.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace eigencast::broker {
namespace {

constexpr TimeUs kSupplyEveryUs = 50'000;
constexpr int kSuppliedAtOnce = 256;

}  // namespace

bool LoopShare::take(const std::string& holder, double us, TimeUs wait_us, std::function<void()> then, Hold hold) {
  const TimeUs now_us = steady_now_us();
  Work work{holder, us, std::move(then), std::move(hold)};
  if (wait_us > 0) {
    later_.emplace(now_us + wait_us, std::move(work));
  } else if (is_supplied(work, now_us)) {
    if (is_free(now_us)) return pay(us, now_us), true;
    wait(std::move(work));
  }
  arm();
  return false;
}

/// False: it waits for what it needs, behind others of its holder, or is gone.
bool LoopShare::is_supplied(Work& work, TimeUs now_us) {
  if (!work.hold) return true;
  const Supply supply = short_.contains(work.holder) ? Supply::kShort : work.hold();
  if (supply != Supply::kShort) return supply == Supply::kHeld;
  if (short_.empty()) supply_at_us_ = now_us + kSupplyEveryUs;
  auto& others = short_[work.holder];
  others.push_back(std::move(work));
  return false;
}

void LoopShare::supply() {
  std::size_t in_vain = 0;
  for (int i = 0; i < kSuppliedAtOnce && in_vain < short_.size(); ++i) {
    auto next = short_.upper_bound(supplied_);
    if (next == short_.end()) next = short_.begin();
    supplied_ = next->first;
    auto& works = next->second;
    const Supply supply = works.front().hold();
    in_vain = supply == Supply::kShort ? in_vain + 1 : 0;
    if (in_vain > 0) continue;
    if (supply == Supply::kHeld) wait(std::move(works.front()));
    works.pop_front();
    if (works.empty()) short_.erase(next);
  }
}

void LoopShare::wait(Work work) {
  const std::string holder = work.holder;
  waiting_.push(holder, static_cast<std::int64_t>(std::ceil(work.us)), std::move(work));
}

void LoopShare::arm() {
  if (waiting_.empty() && later_.empty() && short_.empty()) return;
  TimeUs next_us = later_.empty() ? std::numeric_limits<TimeUs>::max() : later_.begin()->first;
  if (!waiting_.empty()) next_us = std::min(next_us, static_cast<TimeUs>(std::ceil(paid_until_us_ - kAtOnceUs)));
  if (!short_.empty()) next_us = std::min(next_us, supply_at_us_);
  if (armed_us_ != 0 && armed_us_ <= next_us) return;
  armed_us_ = next_us;
  timer_.expires_at(std::chrono::steady_clock::time_point(std::chrono::microseconds(next_us)));
  timer_.async_wait([this](ErrorOf error) {
    if (!error) serve();
  });
}

void LoopShare::serve() {
  armed_us_ = 0;
  const TimeUs now_us = steady_now_us();
  while (!later_.empty() && later_.begin()->first <= now_us) {
    Work work = std::move(later_.extract(later_.begin()).mapped());
    if (is_supplied(work, now_us)) wait(std::move(work));
  }
  if (!short_.empty() && supply_at_us_ <= now_us) {
    supply_at_us_ = now_us + kSupplyEveryUs;
    supply();
  }
  std::function<void()> then;
  if (!waiting_.empty() && has_time(now_us)) {
    Work work = waiting_.pop().item;
    pay(work.us, now_us);
    then = std::move(work.then);
  }
  arm();  // One at a time: streams come between.
  if (then) then();
}

}  // namespace eigencast::broker
