// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

namespace eigencast::broker {

/// State of one stream that all event loops share. Thread-safe.
struct StreamShare {
  explicit StreamShare(std::uint32_t given) : id(given) {}
  const std::uint32_t id;
  std::atomic<std::uint32_t> watchers{0};  ///< In all loops.
};

/// Assigns stream ids: the same in every loop while any loop knows the name, and never reused. Thread-safe.
class StreamIds {
 public:
  std::shared_ptr<StreamShare> of(std::string_view name);

 private:
  std::mutex mutex_;
  std::map<std::string, std::weak_ptr<StreamShare>, std::less<>> shares_;  ///< GUARDED_BY(mutex_)
  std::size_t sweep_at_ = 64;                                              ///< GUARDED_BY(mutex_)
  std::uint32_t last_ = 0;                                                 ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
