// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast {

/// A continuous level of detail as a prefix: vertices in reverse contraction order, faces by death. Level N is the
/// first N vertices and the first prefix_face_count(N) faces with their corners mapped below N. After Hoppe 1996,
/// "Progressive Meshes", and Melax 1998. Vertices have new numbers.
struct PrefixOrder {
  std::uint32_t base_count = 0;      ///< q: vertices that are never contracted.
  std::vector<std::uint32_t> order;  ///< n: order[new] is the source's number.
  std::vector<std::uint32_t> map;    ///< n: where i goes when it is contracted, map[i] < i; map[i] = i below q.
  std::vector<Face> faces;           ///< Full-resolution corners, by death ascending.
  std::vector<std::uint32_t> death;  ///< One per face, ascending; it exists at N > death[f]. 0: a face of the base.
  std::vector<std::uint32_t> face_source;  ///< One per face: its number in the source.
};

/// For an order that is never cancelled.
inline const std::atomic<bool> kWanted = false;

/// Meshes: half-edge contraction with quadrics (Garland & Heckbert 1997, "Surface Simplification Using Quadric Error
/// Metrics"); clouds: half point-pair contraction with point quadrics (Pauly, Gross, Kobbelt 2002, "Efficient
/// simplification of point-sampled surfaces"). The same bits for the same surface; about a second for 100,000 vertices.
/// The base has about a hundredth of the vertices, at least 4. Down to it a mesh keeps its topology (the link
/// condition) and its boundaries, except that
///   - vertices of no face go first, and vertices as soon as they have lost their last face: nothing shows them;
///   - boundary vertices at one position (seams, triangle soups) are contracted into one before all others;
///   - components of at most 4 vertices may vanish when that is cheapest, if there are other components;
///   - topology goes where it leaves more than 64 vertices and a fiftieth of all (non-manifold edges, many handles).
/// Faces with a repeated corner are left out; a surface with only such faces is ordered as a point cloud.
///   seams  edges (vertices, the lower one first; ascending) that are kept as boundaries are
///   poses  of a mesh: others (n each, finite) that its levels approximate, too. What bends in them keeps its vertices,
///          and faces show their side in all (Mohr & Gleicher 2003, "Deformation sensitive decimation"). Takes 100
///          bytes a vertex for each
///   unwanted  set by another thread: cancels, and an order with a larger base is returned soon
/// Errors: kInvalidArgument (no vertices, an index out of range, a coordinate that is not finite), kTooLarge.
Result<PrefixOrder> build_prefix_order(const Surface& surface,
                                       std::span<const std::pair<std::uint32_t, std::uint32_t>> seams = {},
                                       std::span<const std::vector<Vec3>> poses = {},
                                       const std::atomic<bool>& unwanted = kWanted);

/// Number of faces that exist with N vertices. O(log F). REQUIRES: N <= n.
std::uint32_t prefix_face_count(std::span<const std::uint32_t> death, std::uint32_t N);

/// The vertex that represents vertex `a` with N vertices: follows map until it is below N. REQUIRES: base_count <= N.
std::uint32_t prefix_corner(std::span<const std::uint32_t> map, std::uint32_t a, std::uint32_t N);

}  // namespace eigencast
