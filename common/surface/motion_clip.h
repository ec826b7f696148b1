// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/rig.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Readers refuse clips of more frames.
inline constexpr std::size_t kMaxClipFrames = 1'000'000;

/// A deforming surface of constant topology. pose() may read a file. Not thread-safe.
class MotionClip {
 public:
  virtual ~MotionClip() = default;
  virtual const Surface& rest() const = 0;
  /// Of one loop.
  virtual std::size_t frame_count() const = 0;
  /// Poses a second: what the source states, else 30.
  virtual double frame_rate_hz() const = 0;
  /// n x 3, in the order of rest(). REQUIRES: frame < frame_count().
  /// Errors: kIo, kCorrupt; kInvalidArgument when the topology differs from rest(), naming frame and difference.
  virtual Result<std::vector<Vec3>> pose(std::size_t frame) const = 0;
  /// Whether velocity() gives any: where motion is a formula, not a list of poses.
  virtual bool has_velocities() const { return false; }
  /// n x 3, per second of the clip, exact. REQUIRES: frame < frame_count(). Errors: kUnsupported (there are none).
  virtual Result<std::vector<Vec3>> velocity(std::size_t /*frame*/) const {
    return fail(ErrorCode::kUnsupported, name() + " is a list of poses and states no velocities; built-in motions do");
  }
  /// Where the clip comes from, for people.
  virtual std::string name() const = 0;
  /// What opening it changed, for its user, a line each: seams welded, parts left out.
  virtual std::vector<std::string> notes() const { return {}; }
  /// Skin and morph targets, where the source has them; else null. Lives as long as the clip.
  virtual const Rig* rig() const { return nullptr; }
  /// Texture coordinates, colours and textures, where the source has them; else null. Lives as long as the clip.
  virtual const Appearance* appearance() const { return nullptr; }
};

}  // namespace eigencast
