// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>

#include "common/core/result.h"

namespace eigencast {

/// Memory that things of one kind may take together. Thread-safe; outlives its shares.
class MemoryBudget {
 public:
  using Share = std::shared_ptr<void>;  ///< Goes back to the budget with the last copy.

  explicit MemoryBudget(std::uint64_t bytes) : limit_(bytes) {}
  MemoryBudget(const MemoryBudget&) = delete;
  MemoryBudget& operator=(const MemoryBudget&) = delete;

  /// `what` is for the message. Errors: kTooLarge (over the limit with what is taken).
  Result<Share> take(std::uint64_t bytes, const std::string& what);
  /// Shares that are out stay valid, even above the limit.
  void set_limit(std::uint64_t bytes);
  std::uint64_t remaining() const;

 private:
  mutable std::mutex mutex_;
  std::uint64_t limit_;      ///< GUARDED_BY(mutex_)
  std::uint64_t taken_ = 0;  ///< GUARDED_BY(mutex_)
};

/// The budget of this process for surfaces and textures that come from brokers: at first three quarters of the
/// usable_memory() that its first caller found.
MemoryBudget& received_memory();

}  // namespace eigencast
