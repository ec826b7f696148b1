// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/asset/format/encode.h"
#include "common/codec/memory_keeper.h"
#include "common/codec/pose_memory.h"
#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/wire/control.h"
#include "sdk/publisher.h"

namespace eigencast {

/// What a publisher wants its broker to hold of a memory of poses, and what that holds. Pure: no thread, no clock, no
/// socket. Not thread-safe.
class SenderMemory {
 public:
  SenderMemory(CoefficientLayout layout, std::optional<MemoryKeeper::Options> keeper);

  /// From now on the caller decides what to remember.
  void decide_by_caller() { keeper_.reset(); }
  bool decides() const { return keeper_.has_value(); }
  /// A key has left. True: want(segments_to_keep()) is due, for the first time or after a refusal. REQUIRES: decides().
  bool add(const MemoryKeeper::Sent& sent, TimeUs now_us);
  const std::vector<CodedSegment>& segments_to_keep() const { return keeper_->segments(); }  ///< REQUIRES: decides().
  bool may_grow() const { return !state_.pending && !state_.refused; }

  /// Errors: as Publisher::remember.
  Result<void> want(std::vector<CodedSegment> segments);
  /// Of the segments wanted, those that the broker lacks.
  std::vector<AssetObject> missing() const;
  /// Tells the broker once it has those.
  control::Remember message(const std::string& stream);
  /// The message has left. True: it begins another memory, so that keys are plain until it is held.
  bool asked();
  bool awaits(std::uint32_t generation) const { return state_.pending && generation == asked_generation_; }
  /// The broker holds what was asked for: its poses, null where there are none. REQUIRES: awaits().
  std::shared_ptr<const PoseMemory> hold();
  void refuse(const Error& why, TimeUs now_us);
  /// The broker has nothing of it (any more).
  void forget();

  const Publisher::MemoryState& state() const { return state_; }
  std::uint64_t saved_bytes() const;  ///< By keys predicted from it; 0 where the caller decides.
  std::uint64_t bytes() const;        ///< Of segments; likewise.

 private:
  std::size_t kept_segments() const;

  const CoefficientLayout layout_;
  std::optional<MemoryKeeper> keeper_;
  Publisher::MemoryState state_;
  std::vector<AssetObject> wanted_;          ///< Segments,
  std::shared_ptr<const PoseMemory> poses_;  ///< and their poses.
  std::vector<Sha256> held_;                 ///< Segments that the broker holds.
  std::uint32_t asked_generation_ = 0;       ///< Grows.
  TimeUs retry_us_ = 0, retry_at_us_ = 0;    ///< After a refusal.
};

}  // namespace eigencast
