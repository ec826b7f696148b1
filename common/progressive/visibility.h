// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::progressive {

/// On which side of a point the outside lies, as far as it can be seen from there.
struct SideVote {
  double along = 0;  ///< Sum of n . d over the directions d from which the point is seen.
  double all = 0;    ///< Sum of |n . d| over the same.
};

/// Looks at the points from 64 directions, each point a disc across its normal, drawn into a buffer of depths: what is
/// seen of a closed surface is seen from outside. Points deep inside a fold may be seen from nowhere; sheets are seen
/// from both sides. After Katz, Tal, Basri 2007, "Direct visibility of point sets", in its aim, not in its means.
///   normals  n, unit length, of any sign
///   radii    n, of the discs: large enough to leave no gaps; points of radius 0 neither hide nor vote
/// The same votes however many threads there are. Takes up to 64 MB a thread.
std::vector<SideVote> side_votes(std::span<const Vec3> positions, std::span<const Vec3> normals,
                                 std::span<const double> radii);

}  // namespace eigencast::progressive
