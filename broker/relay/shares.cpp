// SPDX-License-Identifier: MIT
#include "broker/relay/shares.h"

#include "common/core/share.h"

namespace eigencast::broker {

bool Shares::fits(const std::string& holder, std::int64_t amount, std::int64_t max, bool alone) const {
  const std::lock_guard lock(mutex_);
  const auto found = held_.find(holder);
  const std::int64_t own = found == held_.end() ? 0 : found->second;
  return own + amount <= share_of(max, alone ? own : used(), own, holder.empty());
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
