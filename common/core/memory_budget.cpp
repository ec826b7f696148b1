// SPDX-License-Identifier: MIT
#include "common/core/memory_budget.h"

#include <algorithm>

#include "common/core/machine.h"

namespace eigencast {

Result<MemoryBudget::Share> MemoryBudget::take(std::uint64_t bytes, const std::string& what) {
  {
    const std::lock_guard lock(mutex_);
    const std::uint64_t left = limit_ - std::min(limit_, taken_);
    if (bytes > left) {
      constexpr std::uint64_t kMegabyte = 1'000'000;
      return fail(ErrorCode::kTooLarge,
                  what + " may take " + std::to_string(bytes / kMegabyte) + " MB of memory, " +
                      std::to_string(left / kMegabyte) + " of " + std::to_string(limit_ / kMegabyte) +
                      " MB are left for what brokers send: allow more (eigencast-client --memory)");
    }
    taken_ += bytes;
  }
  return Share(this, [bytes](void* budget) {
    auto& mine = *static_cast<MemoryBudget*>(budget);
    const std::lock_guard lock(mine.mutex_);
    mine.taken_ -= bytes;
  });
}

void MemoryBudget::set_limit(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  limit_ = bytes;
}

std::uint64_t MemoryBudget::remaining() const {
  const std::lock_guard lock(mutex_);
  return limit_ - std::min(limit_, taken_);
}

MemoryBudget& received_memory() {
  constexpr double kPart = 0.75, kUpperBound = 1e18;  // Where nothing says what there is.
  const double bytes = std::min(kPart * usable_memory(), kUpperBound);
  static auto* const budget = new MemoryBudget(static_cast<std::uint64_t>(bytes));
  return *budget;  // Threads that end late still give back.
}

}  // namespace eigencast
