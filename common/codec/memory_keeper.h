// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "common/codec/pose_memory.h"
#include "common/codec/recaller.h"

namespace eigencast {

/// Decides what a sender remembers. Keeps the true poses of the last minute, and predicts each key from those as well:
/// what that saves, beyond what receivers' memory saves already, is the credit of the poses that it came from. A run of
/// poses is remembered when its credit exceeds its bytes, or at once when the motion comes again step by step; twice as
/// much as has come again so far. Runs that were not worth their bytes stop it: all in all a stream takes at most a
/// hundredth more than without a memory, and a stake of five seconds. Pure. Not thread-safe.
/// Holds at most 1,024 poses and 8 MiB twice, its segments beside them.
class MemoryKeeper {
 public:
  struct Options {
    CoefficientLayout layout;  ///< Not of a float codec.
    AssetDigest asset{};
    double bitrate = 0;    ///< Bits a second of the stream: segments take at most a fifth in any minute; 0: any.
    bool at_once = false;  ///< Remember all that is new, without waiting for it to come again.
  };
  static constexpr TimeUs kSpanUs = 60'000'000;  ///< Of the poses that it looks back at.
  static constexpr TimeUs kStakeUs = 5'000'000;  ///< As much as keys take in so long may be lost.
  static constexpr double kLoss = 0.01;          ///< And this part of the stream.
  static constexpr double kShareOfBitrate = 0.2;
  static constexpr std::size_t kSegmentBytes = 400;  ///< Counted beside those of each segment: requests, messages.

  explicit MemoryKeeper(Options options) : options_(std::move(options)) {}

  struct Sent {
    const ChainState& before;            ///< Of the chain.
    const Key& pose;                     ///< As it was to be coded: with all bands. Others are not remembered.
    std::size_t bytes = 0;               ///< Its payload, and
    std::optional<std::uint32_t> phase;  ///< where in the memory it was predicted from, if it was.
    std::uint8_t half_spacing = 0;
    TimeUs capture_us = 0;  ///< Grows.
    bool may_grow = true;   ///< False while receivers do not hold segments() yet.
  };
  /// A key was sent. Returns true where segments() has changed: receivers should hold those from now on.
  bool add(const Sent& sent);
  /// The whole memory, oldest first. Only grows, except where it would exceed PoseMemory's limits: then the segments
  /// that saved least lately are left out, and phases are others.
  const std::vector<CodedSegment>& segments() const { return segments_; }
  double saved_bits() const { return saved_bits_; }           ///< By keys, so far.
  double remembered_bits() const { return published_bits_; }  ///< By segments, so far.
  /// Of an earlier stream of the surface. Errors: kTooLarge.
  Result<void> restore(std::vector<CodedSegment> segments);

 private:
  struct Pose {
    std::vector<std::int32_t> q;
    TimeUs at_us = 0;
    std::uint64_t like = 0;  ///< Numbers the first pose that this one is like, or itself.
    double credit = 0;       ///< Bits.
    bool covered = false;    ///< The memory has it, or one like it.
  };
  struct Run {
    std::size_t first = 0, last = 0;  ///< Of history_; last exclusive.
    std::size_t covers = 0;           ///< Where it comes again itself: poses up to here are like its own.
  };
  struct Published {
    TimeUs at_us;
    double bits;
  };

  static double distance(const Pose& a, const Pose& b);
  void note_pose(const Sent& sent, std::uint64_t like, bool is_covered);
  void look_back(const Sent& sent, double plain_bits, bool is_covered);
  void take_stock();
  std::optional<Run> run_ahead() const;
  std::optional<Run> run_of_credit() const;
  std::optional<Run> run_of_new() const;
  Run uncovered_from(std::size_t first, TimeUs until_us) const;
  double allowed_bits() const;
  bool grow(Run run, const Sent& sent, bool by_credit);
  void make_room(std::size_t poses);

  Options options_;
  std::vector<CodedSegment> segments_;
  std::vector<double> used_bits_;  ///< By segment: what it saved lately.
  std::deque<Pose> history_;
  std::uint8_t step_ = 0;            ///< Of its poses.
  std::uint64_t history_first_ = 0;  ///< Numbers its first pose; likewise:
  std::uint64_t shadow_first_ = 0;
  std::optional<Recaller> shadow_;      ///< Over history_ as it was up to a second ago.
  std::optional<std::uint32_t> phase_;  ///< Of the last key in the shadow.
  std::uint64_t last_phase_ = 0;        ///< Likewise, from pose 0 on.
  TimeUs recurred_us_ = 0;              ///< How long the motion has been coming again.
  std::optional<TimeUs> first_us_;
  TimeUs last_us_ = 0, decided_us_ = 0, tried_us_ = 0;
  double key_bits_ = 0, gap_us_ = 0;       ///< Of a key without memory, on average, and from one to the next.
  double begin_bits_ = 0, cost_bits_ = 0;  ///< Of a segment, and of each pose more.
  double sent_bits_ = 0, saved_bits_ = 0, published_bits_ = 0;
  std::deque<Published> published_;  ///< In the last minute.
};

}  // namespace eigencast
