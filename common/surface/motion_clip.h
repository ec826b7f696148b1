// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What moves a rigged surface, so that a basis can be made of it that holds every pose exactly: with w the influences
/// and d the morph targets of vertex i, pose(i) = sum_j w_ij B_j (p_i + sum_k a_k d_ki), where B and a change with
/// time. All n are those of the clip's rest(), after welding.
struct Rig {
  struct Influence {
    std::uint32_t bone = 0;  ///< Column of the basis' weights; below `bones`.
    double weight = 0;       ///< Above 0; those of a vertex add up to 1.
  };
  struct MorphTarget {
    std::string name;
    std::vector<std::uint32_t> vertices;  ///< That it moves, ascending.
    std::vector<Vec3> offsets;            ///< As many.
  };
  std::vector<std::string> bones;  ///< Joints, and nodes that carry surfaces without a skin. Names, for people.
  std::vector<Vec3> bind;          ///< n x 3: p, before any bone or morph target.
  std::vector<std::uint32_t> first_influence;  ///< n + 1: vertex i has influences [first[i], first[i + 1]).
  std::vector<Influence> influences;
  std::vector<MorphTarget> targets;
};

inline constexpr std::size_t kMaxClipFrames = 1'000'000;  ///< Readers refuse more.

/// A deforming surface of constant topology. pose() may read a file. Not thread-safe.
class MotionClip {
 public:
  virtual ~MotionClip() = default;
  virtual const Surface& rest() const = 0;
  virtual std::size_t frame_count() const = 0;  ///< Counts one loop.
  virtual double frame_rate_hz() const = 0;     ///< What the source states, else 30.
  /// n x 3, in the order of rest(). REQUIRES: frame < frame_count().
  /// Errors: kIo, kCorrupt; kInvalidArgument when the topology differs from rest(), naming frame and difference.
  virtual Result<std::vector<Vec3>> pose(std::size_t frame) const = 0;
  virtual bool has_velocities() const { return false; }  ///< Where motion is a formula, not a list of poses.
  /// n x 3, per second of the clip, exact. REQUIRES: frame < frame_count(). Errors: kUnsupported (there are none).
  virtual Result<std::vector<Vec3>> velocity(std::size_t /*frame*/) const {
    return fail(ErrorCode::kUnsupported, name() + " is a list of poses and states no velocities; built-in motions do");
  }
  virtual std::string name() const = 0;  ///< Where it comes from, for people.
  /// What opening it changed, for its user, a line each: seams welded, parts left out.
  virtual std::vector<std::string> notes() const { return {}; }
  virtual const Rig* rig() const { return nullptr; }                ///< Lives as long as the clip; null: none.
  virtual const Appearance* appearance() const { return nullptr; }  ///< Likewise.
};

struct ClipOptions {
  std::string rest{};       ///< File of the rest pose (default: beside a cache; else the first frame).
  std::string faces{};      ///< Faces of a .npy clip (default: faces.npy beside it).
  std::string animation{};  ///< Name or number of one of a glTF file's animations (default: the first).
  double rate_hz = 30;      ///< Poses a second of formats that state curves instead of poses.
};

}  // namespace eigencast
