// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace eigencast {

class GpuSurface;

/// A rebuilt surface to draw. Versions grow when their part changes. Positions and normals are empty where the GPU
/// holds them (make_gpu_rebuilder()).
struct SurfaceGeometry {
  std::uint64_t maker = 0;               ///< The owner of the versions.
  std::vector<float> positions;          ///< N x 3, scene units, in level-of-detail order.
  std::vector<float> normals;            ///< N x 3; empty for a point cloud whose asset brings none.
  std::vector<float> radii;              ///< N, of a point cloud's discs, surface units; may be empty.
  std::vector<std::uint32_t> triangles;  ///< 3 indices each.
  std::uint64_t pose_version = 0;        ///< For positions and normals.
  std::uint64_t level_version = 0;       ///< For radii.
  std::uint64_t topology_version = 0;    ///< For triangles.
  /// For each block of LevelTriangles::kBlock indices the topology_version of its last change; empty: unknown.
  std::vector<std::uint64_t> triangle_blocks;
  bool is_point_cloud = false;
  float point_spacing = 0;  ///< Typical distance of neighbours at this level, scene units.

  std::shared_ptr<GpuSurface> gpu;  ///< If the GPU has rebuilt it.
  std::uint32_t gpu_vertices = 0;   ///< N of `gpu`.
  std::uint32_t vertex_count() const { return gpu ? gpu_vertices : static_cast<std::uint32_t>(positions.size() / 3); }

  /// Rebuilt positions of the vertices that move between levels: from unmorphed_first to the last.
  std::vector<float> unmorphed;
  std::uint32_t unmorphed_first = 0;
};

}  // namespace eigencast
