// SPDX-License-Identifier: MIT
#include "broker/relay/stream_ids.h"

namespace eigencast::broker {

std::shared_ptr<StreamShare> StreamIds::of(std::string_view name) {
  const std::lock_guard lock(mutex_);
  const auto found = shares_.find(name);
  if (found != shares_.end()) {
    if (auto known = found->second.lock()) return known;
  }
  if (shares_.size() >= sweep_at_) {
    std::erase_if(shares_, [](const auto& item) { return item.second.expired(); });
    sweep_at_ = 2 * shares_.size() + 64;
  }
  auto share = std::make_shared<StreamShare>(++last_);
  shares_.insert_or_assign(std::string(name), share);
  return share;
}

}  // namespace eigencast::broker
