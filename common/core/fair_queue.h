// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "common/core/share.h"

namespace eigencast {

/// What waits for something of which all have too little, in fair turns: next is an item of the holder who has had
/// least, by costs, since others began to wait; those of one holder keep their order (Goyal, Vin and Cheng: Start-time
/// Fair Queueing, 1996). Holds no clock. Not thread-safe.
template <typename Item, typename Key = std::string>
class FairQueue {
 public:
  struct Waiting {
    std::int64_t cost;
    Item item;
  };

  /// False, and nothing changes: its holder has its share_of() `max` already, in costs; one without a name is spared.
  bool push(const Key& holder, std::int64_t cost, Item item, std::int64_t max = std::int64_t{1} << 62) {
    const auto found = holders_.find(holder);
    const std::int64_t waiting = found == holders_.end() ? 0 : found->second.cost;
    if (waiting + cost > share_of(max, cost_, waiting, holder == Key())) return false;
    Holder& own = found == holders_.end() ? holders_[holder] : found->second;
    if (own.items.empty()) turns_.emplace(own.had = std::max(own.had, had_), &own);
    own.items.push_back({cost, std::move(item)});
    own.cost += cost;
    cost_ += cost;
    return true;
  }

  bool empty() const { return turns_.empty(); }

  /// REQUIRES: !empty().
  Waiting pop() {
    auto turn = turns_.extract(turns_.begin());
    Holder& own = *turn.value().second;
    Waiting next = std::move(own.items.front());
    own.items.pop_front();
    own.cost -= next.cost;
    cost_ -= next.cost;
    had_ = own.had;
    own.had += next.cost;
    if (!own.items.empty()) {
      turn.value().first = own.had;
      turns_.insert(std::move(turn));
    } else if (turns_.empty()) {
      *this = {};
    } else if (holders_.size() >= sweep_at_) {
      std::erase_if(holders_,
                    [this](const auto& other) { return other.second.items.empty() && other.second.had <= had_; });
      sweep_at_ = 2 * holders_.size() + 64;
    }
    return next;
  }

 private:
  struct Holder {
    std::int64_t had = 0;   ///< When its next item's turn is, as had_.
    std::int64_t cost = 0;  ///< Of its items.
    std::deque<Waiting> items;
  };

  std::map<Key, Holder> holders_;
  std::set<std::pair<std::int64_t, Holder*>> turns_;  ///< Of those who have items.
  std::int64_t had_ = 0;                              ///< What those had whose turn it was last.
  std::int64_t cost_ = 0;                             ///< Of all items.
  std::size_t sweep_at_ = 64;
};

}  // namespace eigencast
