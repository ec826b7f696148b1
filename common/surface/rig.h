// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// Rows x columns are those of column vectors; stored by columns: m[4 * column + row].
using Matrix4 = std::array<double, 16>;

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

}  // namespace eigencast
