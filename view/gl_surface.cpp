// SPDX-License-Identifier: MIT
#include "view/gl_surface.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <span>
#include <utility>

#include "common/reconstruction/level_triangles.h"

namespace eigencast {
namespace {

constexpr GLuint kPosition = 0, kNormal = 1, kPaint = 2, kRadius = 3;

void set_array(GLuint number, GLuint buffer, GLint floats, GLsizei stride) {
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  glVertexAttribPointer(number, floats, GL_FLOAT, GL_FALSE, stride, nullptr);
  glEnableVertexAttribArray(number);
}

}  // namespace

void GlTriangles::follow(const SurfaceGeometry& geometry) {
  if (std::exchange(maker_, geometry.maker) != geometry.maker) count_ = 0, version_ = 0;
  if (geometry.topology_version == version_) return;
  const std::uint64_t had = std::exchange(version_, geometry.topology_version);
  const std::span<const std::uint32_t> indices = geometry.triangles;
  count_ = static_cast<GLsizei>(indices.size());
  buffer_.update(indices, std::span<const std::uint64_t>(geometry.triangle_blocks), LevelTriangles::kBlock, had);
}

void GlSurface::place(const glm::mat4& scene_from_surface) {
  scene_from_surface_ = scene_from_surface;
  const glm::mat3 linear(scene_from_surface);
  // The cofactors are right for mirrors, shears and flattening, too.
  scene_from_normal_ =
      glm::mat3(glm::cross(linear[1], linear[2]), glm::cross(linear[2], linear[0]), glm::cross(linear[0], linear[1]));
  const float determinant = glm::determinant(linear);
  if (determinant < 0) scene_from_normal_ = -scene_from_normal_;
  scale_ = std::cbrt(std::abs(determinant));
}

void GlSurface::upload(const SurfaceGeometry& geometry) {
  const bool other_maker = std::exchange(maker_, geometry.maker) != geometry.maker;
  const bool other_gpu = std::exchange(gpu_, geometry.gpu.get()) != geometry.gpu.get();
  if (other_maker || other_gpu) pose_version_ = level_version_ = topology_version_ = 0;
  is_point_cloud_ = geometry.is_point_cloud;
  spacing_ = geometry.point_spacing;
  glBindVertexArray(array_.id());
  if (std::exchange(pose_version_, geometry.pose_version) != geometry.pose_version) take_pose(geometry);
  if (std::exchange(level_version_, geometry.level_version) != geometry.level_version) take_radii(geometry);
  if (std::exchange(topology_version_, geometry.topology_version) != geometry.topology_version)
    take_triangles(geometry);
}

void GlSurface::take_pose(const SurfaceGeometry& geometry) {
  vertex_count_ = static_cast<GLsizei>(geometry.vertex_count());
  const GpuSurface* gpu = geometry.gpu.get();
  if (gpu == nullptr) {
    positions_.replace(std::span<const float>(geometry.positions));
    normals_.replace(std::span<const float>(geometry.normals));
  }
  gpu != nullptr ? set_array(kPosition, gpu->drawn().id(), 3, GpuSurface::kPositionBytes)
                 : set_array(kPosition, positions_.id(), 3, 0);
  if (gpu != nullptr ? !gpu->has_normals : geometry.normals.empty()) {
    glDisableVertexAttribArray(kNormal);
    glVertexAttrib3f(kNormal, 0, 0, 0);
  } else {
    gpu != nullptr ? set_array(kNormal, gpu->normals.id(), 3, GpuSurface::kNormalBytes)
                   : set_array(kNormal, normals_.id(), 3, 0);
  }
}

void GlSurface::take_radii(const SurfaceGeometry& geometry) {
  has_discs_ = !geometry.radii.empty();
  if (!has_discs_) return glDisableVertexAttribArray(kRadius);
  radii_.replace(std::span<const float>(geometry.radii));
  set_array(kRadius, radii_.id(), 1, 0);
}

void GlSurface::take_triangles(const SurfaceGeometry& geometry) {
  if (!geometry.gpu) triangles_.follow(geometry);
  const GlTriangles& triangles = geometry.gpu ? geometry.gpu->triangles : triangles_;
  index_count_ = triangles.count();
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, triangles.buffer());
}

void GlSurface::paint(const SurfacePaint& paint) {
  if (paint.version == paint_version_) return;
  paint_version_ = paint.version;
  const bool numbers = paint.kind == SurfacePaint::Kind::kScalar, textured = paint.kind == SurfacePaint::Kind::kTexture,
             colours = textured || paint.kind == SurfacePaint::Kind::kColour;
  if (!textured) texture_.reset();
  if (textured && !texture_) texture_ = std::make_unique<GlTexturePaint>();
  if (textured) texture_->follow(paint);
  paint_ = numbers ? 1 : colours ? 2 : paint.kind == SurfacePaint::Kind::kNormal ? 3 : 0;
  glBindVertexArray(array_.id());
  glDisableVertexAttribArray(kPaint);
  glVertexAttrib3f(kPaint, 0, 0, 0);
  if (!numbers && !colours) return;
  values_.replace(std::span<const float>(paint.values));
  set_array(kPaint, values_.id(), numbers ? 1 : 3, 0);
}

void GlSurface::bind(const GlProgram& program) const {
  program.set("paint", paint_);
  program.set("colourfulness", colourfulness);
  program.set("scene_from_surface", scene_from_surface_);
  program.set("scene_from_normal", scene_from_normal_);
  glBindVertexArray(array_.id());
}

}  // namespace eigencast
