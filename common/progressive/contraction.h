// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::progressive {

/// Marks a contraction of a vertex that no face shows any more: its target is chosen at the end.
inline constexpr std::uint32_t kNoTarget = 0xffffffff;

/// One contraction, in source numbers.
struct Step {
  std::uint32_t from = 0;
  std::uint32_t to = 0;  ///< kNoTarget: any vertex will do.
};

/// A contraction that may be made next; a std::priority_queue of them has the cheapest on top, numbers decide between
/// equals.
struct Candidate {
  double cost;
  std::uint32_t from, to, version;
  bool operator<(const Candidate& other) const { return cost != other.cost ? cost > other.cost : from > other.from; }
};

/// Contractions of a mesh in the order in which they are made, at least cost over all poses, the rest pose first and
/// alone in saying what hangs together. No face has a repeated corner; positions (n in each pose) are finite and have
/// been brought to unit size. `seams`: edges (the lower vertex first; ascending) that hold their line as boundaries do.
/// Ends early once it is unwanted.
std::vector<Step> contract_mesh(std::span<const std::vector<Vec3>> poses, std::span<const Face> faces,
                                std::span<const std::pair<std::uint32_t, std::uint32_t>> seams,
                                const std::atomic<bool>& unwanted);

/// Contractions of a point cloud in the order in which they are made. As above.
std::vector<Step> contract_points(std::span<const Vec3> positions, const std::atomic<bool>& unwanted);

/// How far to go: a hundredth of the vertices, at least 4.
std::size_t wanted_base(std::size_t vertices);

/// The first vertex, in order of number, at each vertex's position (to the bit; itself if there is none before it).
std::vector<std::uint32_t> first_at_position(std::span<const Vec3> positions);

}  // namespace eigencast::progressive
