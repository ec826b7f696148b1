// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "common/core/result.h"
#include "common/surface/formats/gltf_file.h"
#include "common/surface/motion_clip.h"

/// Private to common/surface.
namespace eigencast {

/// Rows x columns are those of column vectors; stored by columns: m[4 * column + row].
using Matrix4 = std::array<double, 16>;

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

/// Errors: kCorrupt, kUnsupported (nothing that can be drawn), kTooLarge.
Result<GltfScene> gltf_scene_from_model(const tinygltf::Model& model, GltfNumbers& numbers);

/// Vertices of one primitive of one node, before welding.
struct GltfPart {
  std::size_t node = 0;
  std::vector<Vec3> positions;
  std::vector<Vec3> normals;                            ///< As many, or none.
  std::vector<std::vector<Rig::Influence>> influences;  ///< Sorted by bone.
  std::vector<std::vector<Vec3>> offsets;               ///< Hold each morph target's.
};

class GltfParts {
 public:
  void add(GltfPart part) {
    first_vertex_.push_back(part_of_.size());
    part_of_.resize(part_of_.size() + part.positions.size(), static_cast<std::uint32_t>(parts_.size()));
    parts_.push_back(std::move(part));
  }
  std::size_t size() const { return parts_.size(); }
  std::size_t vertices() const { return part_of_.size(); }
  const GltfPart& of(std::size_t vertex) const { return parts_[part_of_[vertex]]; }
  std::size_t local(std::size_t vertex) const { return vertex - first_vertex_[part_of_[vertex]]; }

 private:
  std::vector<GltfPart> parts_;
  std::vector<std::size_t> first_vertex_;
  std::vector<std::uint32_t> part_of_;  ///< Has one for each vertex.
};

/// Merges vertices at one position that always move alike, and fills the rig's vertices. Drops faces that collapse,
/// with their corners' appearance, and finds where the others' normals agree; the scene's notes say what was done.
/// REQUIRES: the scene's faces are of the parts' vertices; its appearance has a material for each face, and coordinates
/// and colours for each or none.
void weld(const GltfParts& parts, GltfScene& scene);

}  // namespace eigencast
