// SPDX-License-Identifier: MIT
#include "broker/access/ledger.h"

#include <algorithm>
#include <cmath>

namespace eigencast::broker {
namespace {

constexpr TimeUs kSweepEveryUs = 1'000'000;

TimeUs wait_from(double paid_until_us, double amount, double per_s, double burst, TimeUs now_us) {
  const double ahead_us = std::max(paid_until_us - static_cast<double>(now_us), 0.0) + amount * 1e6 / per_s;
  // An amount over the burst is taken when idle, or it never would be.
  const double allowed_us = std::max(burst, amount) * 1e6 / per_s;
  return ahead_us <= allowed_us + 0.5 ? 0 : static_cast<TimeUs>(std::ceil(ahead_us - allowed_us));
}

}  // namespace

bool RateLimiter::take(double amount, double per_s, double burst, TimeUs now_us) {
  if (per_s <= 0) return true;
  double paid_until_us = paid_until_us_;
  double then = 0;
  do {
    if (wait_from(paid_until_us, amount, per_s, burst, now_us) > 0) return false;
    then = std::max(paid_until_us, static_cast<double>(now_us)) + amount * 1e6 / per_s;
  } while (!paid_until_us_.compare_exchange_weak(paid_until_us, then));
  return true;
}

TimeUs RateLimiter::wait_us(double amount, double per_s, double burst, TimeUs now_us) const {
  return per_s <= 0 ? 0 : wait_from(paid_until_us_, amount, per_s, burst, now_us);
}

bool UseCount::take(std::int64_t most) {
  std::int64_t count = count_;
  do {
    if (count >= most) return false;
  } while (!count_.compare_exchange_weak(count, count + 1));
  return true;
}

bool Account::is_idle(TimeUs now_us) const {
  return std::all_of(resources.begin(), resources.end(), [](const UseCount& resource) { return resource.is_idle(); }) &&
         messages.is_idle(now_us) && upload_bytes.is_idle(now_us) && download_bytes.is_idle(now_us) &&
         failures.is_idle(now_us);
}

std::shared_ptr<Account> Ledger::account(const std::string& key, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = accounts_.find(key);
  if (found != accounts_.end()) return found->second;
  if (accounts_.size() >= most_ && now_us - swept_us_ >= kSweepEveryUs) {
    // A sweep visits all accounts: at most once per period.
    swept_us_ = now_us;
    std::erase_if(accounts_,
                  [&](const auto& entry) { return entry.second.use_count() == 1 && entry.second->is_idle(now_us); });
  }
  if (accounts_.size() >= most_) return overflow_;
  return accounts_.emplace(key, std::make_shared<Account>()).first->second;
}

}  // namespace eigencast::broker
