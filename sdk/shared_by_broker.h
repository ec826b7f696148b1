// SPDX-License-Identifier: MIT
#pragma once

#include <list>
#include <memory>
#include <mutex>

#include "common/net/url.h"

namespace eigencast {

/// What the streams of one broker with the same credentials share, as long as one uses it. Thread-safe.
template <typename Shared>
class SharedByBroker {
 public:
  /// The first that `accepts`, or a new one, made from the URL, that must accept.
  template <typename Accepts>
  std::shared_ptr<Shared> get(const BrokerUrl& url, const Accepts& accepts) {
    const std::lock_guard lock(mutex_);
    known_.remove_if([](const Known& known) { return known.shared.expired(); });
    for (const Known& known : known_) {
      if (!is_same_broker(known.url, url)) continue;
      if (auto shared = known.shared.lock(); shared && accepts(*shared)) return shared;
    }
    auto made = std::make_shared<Shared>(url);
    accepts(*made);
    known_.push_back({url, made});
    return made;
  }

 private:
  struct Known {
    BrokerUrl url;
    std::weak_ptr<Shared> shared;
  };
  std::mutex mutex_;
  std::list<Known> known_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast
