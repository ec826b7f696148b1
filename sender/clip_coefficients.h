// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "sender/coefficient_store.h"

namespace eigencast {

/// A clip as coefficients: every frame read, checked and projected before the first is played, in memory that does not
/// grow with the clip. Keeps references to clip and projector. Not thread-safe.
class ClipCoefficients {
 public:
  /// velocities: read and project these as well.
  /// Errors: those of the clip, naming the frame; kCancelled (progress said so); kIo (no room for them on disk);
  /// kUnsupported (it states no velocities).
  static Result<ClipCoefficients> create(const MotionClip& clip, const Projector& projector,
                                         const BakeProgress& progress, bool velocities = false);

  /// r x 3, row-major, and behind them, if asked for, their velocities per second of the clip, likewise. Errors: kIo.
  Result<std::vector<double>> at(std::size_t frame) const;
  /// Frames that do not follow from the others, a line each; see JumpFinder.
  const std::vector<std::string>& findings() const { return findings_; }
  /// Errors: kInvalidArgument: the clip's vertices are in another order than its faces'; see JumpFinder.
  const Result<void>& order() const { return order_; }
  /// False for a clip whose coefficients are more than CoefficientStore takes: it is projected while it plays.
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
