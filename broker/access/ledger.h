// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "common/core/clock.h"

namespace eigencast::broker {

enum class Resource : std::uint8_t { kConnection, kPublisher, kStream };
inline constexpr std::size_t kResources = 3;

/// Takes an amount while no more than `burst` is ahead of the steady rate (the generic cell rate algorithm, ATM Forum
/// 1996). Thread-safe, without a lock.
class RateLimiter {
 public:
  /// `per_s` <= 0: no limit.
  bool take(double amount, double per_s, double burst, TimeUs now_us);
  TimeUs wait_us(double amount, double per_s, double burst, TimeUs now_us) const;
  bool is_idle(TimeUs now_us) const { return paid_until_us_ <= static_cast<double>(now_us); }

 private:
  std::atomic<double> paid_until_us_{0};
};

/// Counts objects in use. Thread-safe, without a lock.
class UseCount {
 public:
  bool take(std::int64_t most);
  void give_back() { --count_; }
  bool is_idle() const { return count_ == 0; }

 private:
  std::atomic<std::int64_t> count_{0};
};

/// Usage of one address or token. Thread-safe.
struct Account {
  std::array<UseCount, kResources> resources;
  RateLimiter messages;
  RateLimiter upload_bytes;
  RateLimiter download_bytes;
  RateLimiter failures;
  bool is_idle(TimeUs now_us) const;
};

/// Accounts by key. When it is full idle ones are removed; if all are in use, further keys share one account, which is
/// stricter for them. Thread-safe: the lock covers lookup, not use.
class Ledger {
 public:
  explicit Ledger(std::size_t most = 65'536) : most_(most) {}

  std::shared_ptr<Account> account(const std::string& key, TimeUs now_us);

 private:
  std::size_t most_;
  std::mutex mutex_;
  std::map<std::string, std::shared_ptr<Account>> accounts_;  ///< GUARDED_BY(mutex_)
  std::shared_ptr<Account> overflow_ = std::make_shared<Account>();
  TimeUs swept_us_ = 0;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
