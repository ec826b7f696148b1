// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/codec/key.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// Names the asset whose surface the poses are of: its SHA-256.
using AssetDigest = std::array<std::uint8_t, 32>;

inline constexpr std::array<std::uint8_t, 4> kSegmentMagic{'E', 'C', 'P', 'M'};  ///< A segment begins with it.

/// Poses in the order in which they followed each other, as all receivers decode them. Immutable.
struct MemorySegment {
  std::uint8_t step = 0;             ///< Of all poses.
  std::uint32_t poses = 0;           ///< At least one.
  std::vector<std::int32_t> values;  ///< Pose by pose, each of the layout's r*c values.
};

struct CodedSegment {
  Bytes bytes;
  std::shared_ptr<const MemorySegment> segment;  ///< As decoded.
};

/// A segment as bytes (integers as in docs/protocol.md):
///   "ECPM" | version u8 = 1 | asset 32 bytes | channels u8 | bands u8 | end varint, of each band
///   | poses varint | payload length varint, payload, of each pose, in order
/// The first payload is a join's, whose newer key is the pose; the others are keys' of all bands, at the same step.
///   poses         of the layout, at one step, with all bands
///   half_spacing  m, 1..63: poses are coded to within about 0.56 m steps rms; the first one exactly
/// Errors: kInvalidArgument (a float codec, no pose, poses that differ in step or lack bands; m), kTooLarge (over the
/// limits of PoseMemory, or beyond +-2^30).
Result<CodedSegment> encode_segment(const CoefficientLayout& layout, const AssetDigest& asset,
                                    std::span<const Key> poses, std::uint8_t half_spacing);

/// Safe on hostile input: what the head claims is checked against PoseMemory's limits before anything is allocated.
/// Errors: kCorrupt (another asset or layout, truncated or superfluous bytes, a pose of another step), kTooLarge,
/// kUnsupported (another version), kInvalidArgument (a float codec).
Result<std::shared_ptr<const MemorySegment>> decode_segment(const CoefficientLayout& layout, const AssetDigest& asset,
                                                            ByteView bytes);

/// Poses of a surface that a sender and its receivers hold alike, so that motion that comes again is predicted from the
/// last time. A phase says where in it: pose `phase / 8`, and `phase % 8` eighths of the way to the next one of its
/// segment. Shares segments with its copies. Thread-safe while it is not assigned to.
class PoseMemory {
 public:
  static constexpr std::size_t kMaxPoses = 1024;
  static constexpr std::size_t kMaxBytes = std::size_t{8} << 20;  ///< Decoded.
  static constexpr std::uint32_t kParts = 8;                      ///< Phases from a pose to the next.

  explicit PoseMemory(CoefficientLayout layout) : layout_(std::move(layout)) {}

  /// Checks a number of poses. Errors: kTooLarge.
  static Result<void> check_size(const CoefficientLayout& layout, std::uint64_t poses);

  /// This memory and the poses of one more segment behind it. Errors: kTooLarge.
  /// REQUIRES: the segment is of this memory's layout.
  Result<PoseMemory> with(std::shared_ptr<const MemorySegment> segment) const;
  /// The same in place. After an error nothing has changed.
  Result<void> add(std::shared_ptr<const MemorySegment> segment);

  const CoefficientLayout& layout() const { return layout_; }
  std::uint32_t pose_count() const { return starts_.empty() ? 0 : starts_.back() + segments_.back()->poses; }
  /// Whether the memory has a pose there. The last pose of a segment leads nowhere.
  bool has(std::uint64_t phase) const;

  /// The values from `first` on of the memory's pose at a phase, at `step`, bit-exact everywhere: the cubic of Catmull
  /// and Rom through the poses p0, p1 (of the phase), p2, p3 of the segment, those beyond its ends as at its ends, then
  /// rescaled. With f = phase % 8, p1 where f is 0, else
  ///   floor((-f (8-f)^2 p0 + ((3f-40) f^2 + 1024) p1 + ((32-3f) f^2 + 64f) p2 - f^2 (8-f) p3 + 512) / 1024)
  /// Returns false if a value leaves the range. REQUIRES: has(phase), first + out.size() <= layout().size().
  bool recall(std::uint32_t phase, std::uint8_t step, std::size_t first, std::span<std::int32_t> out) const;
  /// Stored values of a pose, and their step. REQUIRES: pose < pose_count().
  std::span<const std::int32_t> pose(std::uint32_t pose) const;
  std::uint8_t step_of(std::uint32_t pose) const { return segments_[segment_of(pose)]->step; }

 private:
  std::size_t segment_of(std::uint32_t pose) const;

  CoefficientLayout layout_;
  std::vector<std::shared_ptr<const MemorySegment>> segments_;
  std::vector<std::uint32_t> starts_;  ///< By segment: its first pose.
};

}  // namespace eigencast
