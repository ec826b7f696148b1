// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

namespace eigencast {

class GpuSurface;

/// What is to be drawn: rebuilt positions, normals and triangles. Versions grow when their part has changed.
///
/// Where the GPU has rebuilt the surface (GpuRebuilder) it holds positions and normals, and they are empty
/// here.
struct SurfaceGeometry {
  std::uint64_t maker = 0;               ///< Whose versions these are.
  std::vector<float> positions;          ///< N x 3, scene units, in level-of-detail order.
  std::vector<float> normals;            ///< N x 3; empty for a point cloud whose asset brings none.
  std::vector<float> radii;              ///< N: of a point cloud's discs, surface units; empty as normals.
  std::vector<std::uint32_t> triangles;  ///< 3 indices each.
  std::uint64_t pose_version = 0;        ///< Of positions and normals.
  std::uint64_t level_version = 0;       ///< Of radii.
  std::uint64_t topology_version = 0;    ///< Of triangles.
  /// For each run of LevelTriangles::kBlock indices the topology_version it changed at; empty: all change with each.
  std::vector<std::uint64_t> triangle_blocks;
  bool is_point_cloud = false;
  float point_spacing = 0;  ///< Typical distance of neighbours at this level, scene units.

  std::shared_ptr<GpuSurface> gpu;  ///< Where the GPU has rebuilt it.
  std::uint32_t gpu_vertices = 0;   ///< N there.
  std::uint32_t vertex_count() const { return gpu ? gpu_vertices : static_cast<std::uint32_t>(positions.size() / 3); }

  /// Of the vertices that are drawn elsewhere, on their way between levels: where they belong, from unmorphed_first to the
  /// last.
  std::vector<float> unmorphed;
  std::uint32_t unmorphed_first = 0;
};

}  // namespace eigencast
