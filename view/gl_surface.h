// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "view/camera.h"
#include "view/gl_objects.h"
#include "view/paint.h"
#include "view/rebuild.h"

namespace eigencast {

/// Sends only blocks that have changed.
class GlTriangles final {
 public:
  void follow(const SurfaceGeometry& geometry);
  GLuint buffer() const { return buffer_.id(); }
  GLsizei count() const { return count_; }  ///< Indices.

 private:
  GlBuffer buffer_;
  GLsizei count_ = 0;
  std::uint64_t maker_ = 0, version_ = 0;
};

/// Buffers of a surface that make_gpu_rebuilder() has rebuilt: made on the GPU, never sent.
class GpuSurface final {
 public:
  static constexpr GLsizei kPositionBytes = 4 * sizeof(float);  ///< x, y, z, 1.
  static constexpr GLsizei kNormalBytes = 3 * sizeof(float);    ///< Unit length.

  GlBuffer positions;  ///< As rebuilt.
  GlBuffer morphed;    ///< As drawn, if `morphs`: some vertices move between levels.
  bool morphs = false;
  GlBuffer normals;
  bool has_normals = false;
  GlTriangles triangles;
  GlBuffer extras;  ///< Origin and parent of each extra normal of `corners`; theirs come behind those of all vertices.
  std::shared_ptr<const CornerNormals> corners;
  const GlBuffer& drawn() const { return morphs ? morphed : positions; }
};

/// A surface's wedges and UVs on the GPU. Sends only blocks that have changed. Needs its context current in every call.
class GlTexturePaint final {
 public:
  /// REQUIRES: paint.kind == kTexture.
  void follow(const SurfacePaint& paint);
  /// REQUIRES: follow() was called; a program of textured_shaders().
  void bind(const GlProgram& program) const;

 private:
  GlBuffer corners_, uvs_;
  GlTexture corners_texture_, uvs_texture_;
  std::uint64_t version_ = 0;
  bool times_values_ = false;
  const void* levels_ = nullptr;  ///< Owner of version_, for comparison only.
  std::shared_ptr<const Picture> picture_;
  std::shared_ptr<GlTexture> image_;
};

/// One surface as the GPU draws it. Needs its context current in every call.
class GlSurface final {
 public:
  void upload(const SurfaceGeometry& geometry);
  void paint(const SurfacePaint& paint);
  void place(const glm::mat4& scene_from_surface);

  bool drawable() const { return visible && vertex_count_ > 0; }
  bool is_point_cloud() const { return is_point_cloud_; }
  bool has_discs() const { return has_discs_; }  ///< Points with normals and radii.
  float scale() const { return scale_; }         ///< From surface to scene.
  int paint_mode() const { return paint_; }      ///< Of shaders::kPaint.
  /// What is drawn lies within, in the scene; nothing if only the GPU knows.
  std::optional<Bounds> bounds() const;
  float spacing() const { return spacing_ * scale_; }  ///< Between points, scene units.

  /// Sets the program's transform and binds the arrays.
  void bind(const GlProgram& program) const;
  void draw_triangles() const { glDrawElements(GL_TRIANGLES, index_count_, GL_UNSIGNED_INT, nullptr); }
  /// Without those that look away, where nothing else can be seen of them: of a solid.
  void draw_front_triangles() const;
  void draw_points() const { glDrawArrays(GL_POINTS, 0, vertex_count_); }

  /// Null unless the surface is painted with its image.
  const GlTexturePaint* texture() const { return texture_.get(); }

  bool visible = true;
  float colourfulness = 1;  ///< 0..1

 private:
  void take_pose(const SurfaceGeometry& geometry, std::uint64_t had);
  void take_radii(const SurfaceGeometry& geometry, std::uint64_t had);
  void take_triangles(const SurfaceGeometry& geometry);
  void send(GlBuffer& buffer, std::span<const float> values, std::size_t floats, const BlockVersions& versions,
            std::uint64_t had);

  GlArray array_;
  GlBuffer positions_, normals_, values_, radii_;
  GlTriangles triangles_;
  std::unique_ptr<GlTexturePaint> texture_;
  GLsizei vertex_count_ = 0, index_count_ = 0;
  const GpuSurface* gpu_ = nullptr;  ///< Owner of the bound arrays, for comparison only; null: this.
  std::uint64_t maker_ = 0, pose_version_ = 0, level_version_ = 0, topology_version_ = 0, paint_version_ = 0;
  std::shared_ptr<const CornerNormals> corners_;
  std::span<const std::uint32_t> extras_;  ///< Vertices that are drawn with other normals, too, behind all others.
  std::vector<float> room_;
  int paint_ = 0;  ///< Mode of shaders::kPaint.
  bool is_point_cloud_ = false, has_discs_ = false, is_solid_ = false, is_mirrored_ = false;
  float spacing_ = 0, scale_ = 1, largest_radius_ = 0;
  std::optional<Bounds> bounds_;  ///< Of the vertices, surface units.
  glm::mat4 scene_from_surface_{1};
  glm::mat3 scene_from_normal_{1};
};

/// The vertex shader of meshes, a geometry shader that gives corners their UVs, and `fragment` with own_paint().
GlProgram::Shaders textured_shaders(const std::string& vertex, const std::string& before_fragment,
                                    const std::string& fragment);

}  // namespace eigencast
