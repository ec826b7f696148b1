// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"

namespace eigencast {

/// Coefficients of a clip's frames: in memory while few, else in a temporary file without a name, which goes with the
/// process. Not thread-safe.
class CoefficientStore {
 public:
  static constexpr std::uint64_t kMaxBytesInMemory = std::uint64_t{64} << 20;
  static constexpr std::uint64_t kMaxBytesOnDisk = std::uint64_t{4} << 30;

  /// values: doubles a frame. Errors: kTooLarge (over kMaxBytesOnDisk); kIo (no temporary file can be made).
  static Result<CoefficientStore> create(std::size_t frames, std::size_t values,
                                         std::uint64_t max_bytes_in_memory = kMaxBytesInMemory);

  bool on_disk() const { return file_ != nullptr; }
  /// Errors: kIo (no room). REQUIRES: frame < frames, C.size() == values.
  Result<void> put(std::size_t frame, const std::vector<double>& C);
  /// Errors: kIo. REQUIRES: frame was put.
  Result<std::vector<double>> at(std::size_t frame) const;

 private:
  using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;
  CoefficientStore(std::size_t values, File file) : values_(values), file_(std::move(file)) {}
  bool seek(std::size_t frame) const;

  std::size_t values_;
  File file_;  ///< Null: in memory.
  std::vector<double> memory_;
};

/// A clip as coefficients: every frame read, checked and projected before the first is played, in memory that does not
/// grow with the clip. Keeps references to clip and projector. Not thread-safe.
class ClipCoefficients {
 public:
  /// velocities: project these too. Errors: the clip's, naming the frame; kCancelled; kIo; kUnsupported (it has none).
  static Result<ClipCoefficients> create(const MotionClip& clip, const Projector& projector,
                                         const BakeProgress& progress, bool velocities = false);

  /// r x 3, row-major, and behind them, if asked for, their velocities per second of the clip, likewise. Errors: kIo.
  Result<std::vector<double>> at(std::size_t frame) const;
  const std::vector<std::string>& findings() const { return findings_; }
  /// Errors: kInvalidArgument (another order of vertices). This and findings(): see JumpFinder.
  const Result<void>& order() const { return order_; }
  /// False for more than CoefficientStore takes: it is projected while it plays.
  bool stored() const { return store_.has_value(); }

 private:
  ClipCoefficients(const MotionClip& clip, const Projector& projector, bool velocities)
      : clip_(&clip), projector_(&projector), velocities_(velocities) {}
  Result<std::vector<double>> project(const std::vector<Vec3>& pose, std::size_t frame) const;

  const MotionClip* clip_;
  const Projector* projector_;
  bool velocities_;
  std::optional<CoefficientStore> store_;
  std::vector<std::string> findings_;
  Result<void> order_;
};

}  // namespace eigencast
