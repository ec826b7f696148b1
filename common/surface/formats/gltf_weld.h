// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/surface/formats/gltf_pose.h"

/// Private to common/surface.
namespace eigencast {

/// Vertices of one primitive of one node, before welding.
struct GltfPart {
  std::size_t node = 0;
  std::vector<Vec3> positions;
  std::vector<std::vector<Rig::Influence>> influences;  ///< Sorted by bone.
  std::vector<std::vector<Vec3>> offsets;               ///< Of each morph target.
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
  std::vector<std::uint32_t> part_of_;  ///< Of each vertex.
};

/// Merges vertices at one position that always move alike, and fills the rig's vertices. Drops faces that collapse,
/// with their corners' appearance; the scene's notes say what was done. REQUIRES: the scene's faces are of the parts'
/// vertices; its appearance has a material for each face, and coordinates and colours for each or none.
void weld(const GltfParts& parts, GltfScene& scene);

}  // namespace eigencast
