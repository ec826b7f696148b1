// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/core/clock.h"
#include "common/surface/checks/vertex_order.h"
#include "common/surface/motion_clip.h"

namespace eigencast {

/// The refusal of a clip in another order than its faces' (as of JumpFinder::order), with the way round it.
Result<void> accept_order(const Result<void>& order, bool any_order);

/// Spread evenly over a clip; the last is among them.
std::vector<std::size_t> sample_frames(std::size_t frame_count, std::size_t most);

/// A line about those that do not fit the mesh; empty: all do.
/// Errors: the clip's; kInvalidArgument: most frames certainly are in another order, and `any_order` is false.
Result<std::string> check_frames(const Surface& mesh, const MotionClip& clip, const std::vector<std::size_t>& frames,
                                 bool any_order);

/// Lasts from the start of one check to the next: they take at most a fifth of the time for the first poses, then a
/// fiftieth.
///   size  of the mesh: vertices and faces
TimeUs pause_between_checks(std::uint64_t checked, std::size_t size);

/// The first poses of a mesh, then one every 0.2 s; of large meshes fewer. Not thread-safe.
class ArrivalCheck {
 public:
  ArrivalCheck(const Surface& mesh, bool any_order)
      : order_(mesh), size_(mesh.vertex_count() + mesh.faces.size()), any_order_(any_order) {}

  /// A line where misfits begin or become others; else nothing. positions: n x 3.
  /// Errors: kInvalidArgument: the very first pose certainly is in another order.
  Result<std::optional<std::string>> check(std::span<const float> positions, std::uint64_t number, TimeUs now_us);
  std::uint64_t misfits() const { return misfits_; }  ///< Counts the checked poses.

 private:
  VertexOrder order_;
  std::size_t size_;
  bool any_order_;
  std::uint64_t checked_ = 0, misfits_ = 0;
  TimeUs next_us_ = 0;
  Misfit::Kind before_ = Misfit::Kind::kNone;
};

}  // namespace eigencast
