// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/rig.h"
#include "common/surface/surface.h"

/// Private to common/surface.
namespace eigencast {

/// Each node's transform in its parent and each morph target's weight.
struct GltfPose {
  struct Local {
    Vec3 translation{0, 0, 0};
    std::array<double, 4> rotation{0, 0, 0, 1};  ///< x, y, z, w, unit.
    Vec3 scale{1, 1, 1};
  };
  std::vector<Local> nodes;     ///< One a node of the file.
  std::vector<double> weights;  ///< One a morph target of the rig.
};

/// A file's scene as one surface and what it takes to pose it.
struct GltfScene {
  /// What carries vertices: B = global(node) * inverse_bind.
  struct Bone {
    std::size_t node = 0;
    Matrix4 inverse_bind;
  };
  struct Node {
    int parent = -1;
    bool fixed = false;            ///< Stated as a matrix, which no animation may change.
    Matrix4 matrix;                ///< Where fixed.
    std::size_t first_target = 0;  ///< Its mesh's morph targets in the rig.
    std::size_t target_count = 0;
  };
  std::vector<Face> faces;
  Rig rig;
  std::vector<Bone> bones;                 ///< As many as rig.bones.
  std::vector<Node> nodes;                 ///< As in the file.
  std::vector<std::size_t> parents_first;  ///< Order of nodes in which parents come before children.
  GltfPose rest;
  Appearance appearance;
  std::vector<std::string> notes;

  /// Positions (n x 3), rounded to 32-bit floats. Errors: kCorrupt: one is not finite, naming it.
  Result<std::vector<Vec3>> positions(const GltfPose& pose) const;
};

}  // namespace eigencast
