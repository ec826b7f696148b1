// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/clock.h"

namespace eigencast::broker {

/// Brings the messages of one epoch of a stream at another broker into the order that a sender keeps: a join, then each
/// key after the one before it. Keys come as they are published, and some may be lost; joins come when asked for, and
/// either may be first. Decides only: no network, no clock. Not thread-safe.
///
/// Keys that come while a join is awaited are kept, at most kMaxKept; older ones make place.
class Follower {
 public:
  static constexpr std::size_t kMaxKept = 64;
  /// An answer to a request for a join is awaited for so long.
  static constexpr TimeUs kJoinTimeoutUs = 500'000;

  explicit Follower(std::uint32_t epoch) : epoch_(epoch) {}

  /// A message of the owner: a key as it is published, or the join that was asked for. Returns what may be handed on
  /// now, in order; nothing of other epochs, nothing twice, nothing that is not well formed.
  std::vector<Bytes> take(Bytes message);

  /// Whether to ask for a join now; having asked is remembered until one comes or time is out.
  bool wants_join(TimeUs now_us);
  /// What was handed on could not be used: begin anew with a join.
  void begin_anew();

  std::uint32_t epoch() const { return epoch_; }
  std::uint64_t dropped() const { return dropped_; }  ///< Messages that were of no use.
  std::uint64_t gaps() const { return gaps_; }        ///< Times that keys were missing.

 private:
  struct Kept {
    std::uint64_t sequence;
    Bytes message;
  };
  void drain(std::vector<Bytes>& out);

  std::uint32_t epoch_;
  std::optional<std::uint64_t> newest_;  ///< Sequence of what was handed on last.
  bool joined_ = false;
  std::deque<Kept> kept_;  ///< Ascending sequences.
  std::optional<TimeUs> asked_us_;
  std::uint64_t dropped_ = 0, gaps_ = 0;
};

}  // namespace eigencast::broker
