// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/wire/envelope.h"

namespace eigencast::broker {

/// Restores the order of the messages of one epoch of a remote stream: a join, then consecutive keys. Published keys
/// may be lost; joins come on request, before or after them. Keeps the last kMaxKept keys while a join is awaited,
/// and of them no more than kMaxKeptBytes. A message is epoch u32, sequence u64, and a frame without id and tag.
/// Not thread-safe.
class Follower {
 public:
  static constexpr std::size_t kMaxKept = 64, kMaxKeptBytes = 4u << 20;
  static constexpr std::size_t kHeadBytes = 12;
  static constexpr TimeUs kJoinTimeoutUs = 500'000;

  struct Followed {
    std::uint64_t sequence;
    Bytes message;
    WireFrame frame;  ///< Its payload points into `message`.
  };

  explicit Follower(std::uint32_t epoch) : epoch_(epoch) {}

  bool is_of_epoch(ByteView message) const;
  /// Returns the frames that can be used now, in order; drops other epochs, duplicates and malformed messages.
  std::vector<Followed> take(Bytes message);

  /// Whether to request a join now; false while a request is pending.
  bool wants_join(TimeUs now_us);
  bool is_joined() const { return joined_; }  ///< No join is missing.
  /// Starts again from a join, after a message that could not be used.
  void restart();
  /// The same in another chain: what is kept is of no use.
  void change_chain();

  std::uint64_t dropped() const { return dropped_; }  ///< Unusable messages.

 private:
  void drain(std::vector<Followed>& out);

  std::uint32_t epoch_;
  std::optional<std::uint64_t> newest_;  ///< Sequence of the last returned message.
  bool joined_ = false;
  std::deque<Followed> kept_;  ///< Ascending sequences.
  std::optional<TimeUs> asked_us_;
  std::uint64_t dropped_ = 0;
};

}  // namespace eigencast::broker
