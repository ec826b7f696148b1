// SPDX-License-Identifier: MIT
#include "broker/relay/shares.h"

#include "common/core/share.h"

namespace eigencast::broker {

bool Shares::fits(const std::string& holder, std::int64_t amount, std::int64_t max, std::int64_t freed) const {
  const std::int64_t own = held(holder);
  return own + amount <= share_of(max, used() - freed, own, holder.empty());
}

std::int64_t Shares::held(const std::string& holder) const {
  const std::lock_guard lock(mutex_);
  const auto found = held_.find(holder);
  return found == held_.end() ? 0 : found->second;
}

std::map<std::string, std::int64_t> Shares::all() const {
  const std::lock_guard lock(mutex_);
  return held_;
}

std::shared_ptr<void> Shares::hold(const std::string& holder, std::int64_t amount) {
  std::unique_lock lock(mutex_);
  const auto mine = held_.try_emplace(holder).first;
  mine->second += amount;
  used_ += amount;
  lock.unlock();
  return std::shared_ptr<void>(this, [this, mine, amount](void*) {
    const std::lock_guard lock_again(mutex_);
    used_ -= amount;
    if ((mine->second -= amount) == 0) held_.erase(mine);
  });
}

}  // namespace eigencast::broker
