// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace eigencast::broker {

/// What holders have of something of which there is a `max`: each no more than its share, one without a name all but a
/// sixteenth (common/core/share.h). Thread-safe. Outlives the pointers.
class Shares {
 public:
  static constexpr std::int64_t kUnlimited = std::int64_t{1} << 62;

  /// `freed`: if others had so much less.
  bool fits(const std::string& holder, std::int64_t amount, std::int64_t max, std::int64_t freed = 0) const;
  std::int64_t held(const std::string& holder) const;
  /// Counts until the pointer ends, even if it does not fit.
  std::shared_ptr<void> hold(const std::string& holder, std::int64_t amount);
  std::map<std::string, std::int64_t> all() const;
  std::int64_t used() const { return used_.load(std::memory_order_relaxed); }

 private:
  std::atomic<std::int64_t> used_{0};
  mutable std::mutex mutex_;
  std::map<std::string, std::int64_t> held_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
