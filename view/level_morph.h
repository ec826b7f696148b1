// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// How long vertices take to come and to go: as long as their way on the screen asks for. A vertex that comes is drawn
/// and paid for before it is of use, so that whoever waits longer than anybody can see draws fewer of them in the same
/// time.
struct MorphPace {
  static constexpr TimeUs kAppear = 250'000;      ///< At most.
  static constexpr TimeUs kVanish = 100'000;      ///< Shorter: the time of a picture waits for it.
  static constexpr double kPixelsPerSecond = 30;  ///< Half a pixel from picture to picture at 60/s.
  TimeUs appear_us = kAppear, vanish_us = kVanish;

  /// Of vertices that move `way_px` pixels at most, which may be infinite: unknown.
  static MorphPace of(double way_px);
};

/// Lets vertices come and go without a jump: one that appears starts where the vertex stands that it was contracted
/// into, and moves to its own place; one that vanishes goes back there, and is drawn so long. Vertex i with weight s_i
/// stands at
///
///   y_i = (1 - s_i) y_map(i) + s_i x_i,
///
/// where map(i) < i may be moving itself. Weights never grow along the numbers, so that those that are not 1 are the
/// last. After Hoppe 1996, "Progressive Meshes" (geomorphs).
///
/// Time comes in as arguments. Not thread-safe.
class LevelMorph {
 public:
  /// Weights go on by no more than this in one picture, however long it took.
  static constexpr TimeUs kLongestStep = 50'000;
  /// Who has not looked for so long sees no jump.
  static constexpr TimeUs kOutOfSight = 500'000;

  void jump(std::uint32_t N);

  /// Aims at N vertices and goes on to `now_us`; true if there is anything new to draw.
  bool advance(std::uint32_t N, TimeUs now_us, const MorphPace& pace = {});

  /// Vertices to draw: the first so many.
  std::uint32_t drawn() const { return whole_ + static_cast<std::uint32_t>(weights_.size()); }
  /// The first so many stand at their own place.
  std::uint32_t whole() const { return whole_; }
  /// How much of vertex i < drawn() is there: 1 at its own place.
  float weight(std::uint32_t i) const { return i < whole_ ? 1.0F : weights_[i - whole_]; }
  /// Of the vertices from whole() on.
  std::span<const float> moving() const { return weights_; }
  /// Vertices to draw, each as much as it is there.
  double effective() const;

  /// y from x, in place: 3 floats for each of drawn() vertices, places or whatever else belongs to them alone.
  void blend(std::span<const std::uint32_t> map, std::span<float> values) const;

  /// What belongs to the vertices as a sum over their faces (normals times areas) for who is drawn: each vertex gives
  /// what its place is not its own to the one that it comes from, and sees as much of that one's. Without a jump where
  /// vertices come and go: at weight 0 both are what the surface without the vertex has. In place.
  void share(std::span<const std::uint32_t> map, std::span<float> sums) const;

 private:
  std::uint32_t whole_ = 0;
  std::vector<float> weights_;  ///< Of the vertices from whole_ on.
  std::optional<TimeUs> seen_us_;
};

}  // namespace eigencast
