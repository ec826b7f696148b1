// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// How long vertices take to appear and to vanish: as short as their way on the screen allows, because a moving vertex
/// costs as much as one that has arrived.
struct MorphPace {
  static constexpr TimeUs kAppear = 250'000;      ///< At most.
  static constexpr TimeUs kVanish = 100'000;      ///< At most; shorter, because late pictures wait for it.
  static constexpr double kPixelsPerSecond = 30;  ///< Half a pixel a picture at 60/s.
  TimeUs appear_us = kAppear, vanish_us = kVanish;

  /// way_px: the vertices' longest way on the screen; infinite if unknown.
  static MorphPace of(double way_px);
};

/// Geomorphs between levels of detail (Hoppe 1996, "Progressive Meshes"): a vertex that appears moves from its parent's
/// position to its own; one that vanishes moves back first. Vertex i with weight s_i is drawn at
///
///   y_i = (1 - s_i) y_map(i) + s_i x_i,
///
/// where map(i) < i may be moving itself. Weights never grow along the numbers. Not thread-safe.
class LevelMorph {
 public:
  static constexpr TimeUs kMaxStep = 50'000;      ///< Progress in one picture, however long that took.
  static constexpr TimeUs kOutOfSight = 500'000;  ///< After so long without a picture levels jump.

  void jump(std::uint32_t N);

  /// True if anything has changed.
  bool advance(std::uint32_t N, TimeUs now_us, const MorphPace& pace = {});

  std::uint32_t drawn() const { return whole_ + static_cast<std::uint32_t>(weights_.size()); }
  /// The number of leading vertices that do not move.
  std::uint32_t whole() const { return whole_; }
  /// REQUIRES: i < drawn().
  float weight(std::uint32_t i) const { return i < whole_ ? 1.0F : weights_[i - whole_]; }
  /// Weights of the vertices from whole() on.
  std::span<const float> moving() const { return weights_; }
  /// The sum of all weights.
  double effective() const;

  /// y from x, in place: 3 floats for each of drawn() vertices, positions or other values per vertex.
  void blend(std::span<const std::uint32_t> map, std::span<float> values) const;

  /// Morphs sums over faces (normals times areas), in place: vertex i adds 1 - s_i of its sum to its parent's, and
  /// blends its own with the parent's total. At weight 0 both equal those of the surface without the vertex.
  void share(std::span<const std::uint32_t> map, std::span<float> sums) const;

 private:
  std::uint32_t whole_ = 0;
  std::vector<float> weights_;  ///< See moving().
  std::optional<TimeUs> seen_us_;
};

}  // namespace eigencast
