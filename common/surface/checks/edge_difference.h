// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// How unevenly edges are stretched: perceived error follows this more closely than distances.
struct EdgeDifferenceError {
  double spatial = 0;  ///< Mean over vertices and frames of the deviation of its edges' relative differences.
  double temporal =
      0;  ///< The same of each vertex's path from frame to frame, in windows of three steps; 0 under four frames.
  double combined() const;
};

/// The spatio-temporal edge difference of Vasa & Skala 2011, "A Perception Correlated Comparison Method for Dynamic
/// Meshes": the standard deviation, weighted by |e|, of | |e| - |e~| | / |e| over the edges that meet in a vertex; a
/// vertex's step to the next frame is an edge as well, whose length has kTimeStep of the diagonal added at a right
/// angle, so that a vertex at rest has one. Not thread-safe.
class EdgeDifference {
 public:
  static constexpr double kTimeStep = 0.002;        ///< A share of the diagonal.
  static constexpr double kTemporalWeight = 0.136;  ///< Weighs the temporal part in the combined one.

  /// faces: of a mesh; without any there is nothing to measure, and every error is 0.
  EdgeDifference(std::size_t vertex_count, std::span<const Face> faces, double diagonal);

  void add(std::span<const Vec3> truth, std::span<const Vec3> rebuilt);  ///< REQUIRES: vertex_count each.
  EdgeDifferenceError result() const;

 private:
  struct Edge {
    double length = 0, difference = 0;
  };
  void add_step(std::span<const Vec3> truth, std::span<const Vec3> rebuilt);

  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges_;
  std::vector<std::uint32_t> first_, incident_;  ///< Edges that meet in a vertex.
  double squared_time_step_;
  std::vector<Edge> stretched_;
  std::vector<Vec3> truth_before_, rebuilt_before_;
  std::deque<std::vector<Edge>> steps_;  ///< The last three, of every vertex.
  double spatial_ = 0, temporal_ = 0;
  std::size_t frames_ = 0, windows_ = 0;
};

}  // namespace eigencast
