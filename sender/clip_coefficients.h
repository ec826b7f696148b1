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
