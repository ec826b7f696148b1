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

/// What is counted of each address and each token.
enum class Share : std::uint8_t { kConnection, kPublisher, kStream };
inline constexpr std::size_t kShares = 3;

/// A steady flow with a burst: takes an amount if no more than `burst` of it came ahead of the steady rate (the generic
/// cell rate algorithm, ATM Forum 1996). Time comes in as an argument. Thread-safe, without a lock.
class Pace {
 public:
  /// `per_s` <= 0: no limit.
  bool take(double amount, double per_s, double burst, TimeUs now_us);
  /// How long until `amount` would be taken.
  TimeUs wait_us(double amount, double per_s, double burst, TimeUs now_us) const;
  bool is_idle(TimeUs now_us) const { return paid_until_us_ <= static_cast<double>(now_us); }

 private:
  std::atomic<double> paid_until_us_{0};
};

/// How many of something are in use. Thread-safe, without a lock.
class Tally {
 public:
  /// One more, unless there are `most`.
  bool take(std::int64_t most);
  void give_back() { --count_; }
  bool is_idle() const { return count_ == 0; }

 private:
  std::atomic<std::int64_t> count_{0};
};

/// What one address or one token uses now. Any thread may use any part.
struct Account {
  std::array<Tally, kShares> shares;
  Pace messages;
  Pace upload_bytes;
  Pace download_bytes;
  Pace failures;
  bool is_idle(TimeUs now_us) const;
};

/// The accounts by key. Bounded: idle ones go when room is needed; where all are in use, further keys share one, which
/// is stricter for them and safe for the broker. Thread-safe: the lock is for finding accounts, not for using them.
class Ledger {
 public:
  explicit Ledger(std::size_t most = 65'536) : most_(most) {}

  std::shared_ptr<Account> account(const std::string& key, TimeUs now_us);
  std::size_t size() const;

 private:
  std::size_t most_;
  mutable std::mutex mutex_;
  std::map<std::string, std::shared_ptr<Account>> accounts_;  ///< GUARDED_BY(mutex_)
  std::shared_ptr<Account> overflow_ = std::make_shared<Account>();
  TimeUs swept_us_ = 0;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
