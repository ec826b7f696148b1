// SPDX-License-Identifier: MIT
#include "view/gl_surface.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <map>
#include <span>
#include <utility>

#include "common/reconstruction/level_triangles.h"
#include "view/texture_levels.h"

namespace eigencast {

namespace {

constexpr GLuint kPosition = 0, kNormal = 1, kPaint = 2, kRadius = 3;

void set_array(GLuint number, GLuint buffer, GLint floats, GLsizei stride) {
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  glVertexAttribPointer(number, floats, GL_FLOAT, GL_FALSE, stride, nullptr);
  glEnableVertexAttribArray(number);
}

/// Texture units; 0 and 1 belong to shadow map and colour table.
constexpr int kImageUnit = 2, kCornersUnit = 3, kUvsUnit = 4;
constexpr float kAnisotropy = 8;

/// Corners of one vertex may have several UVs: only the geometry shader knows whose corner it is.
constexpr const char* kGeometry = R"(#version 330 core
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;
in vec3 vertex_at[], vertex_normal[], vertex_painted[];
in float vertex_hard[];
uniform usamplerBuffer corners;
uniform samplerBuffer uvs;
out vec3 at, scene_normal, corner_painted;
out float hard;
out vec2 uv;
flat out int in_image;
void main() {
  vec2 corner_uv[3];
  in_image = 1;
  for (int k = 0; k < 3; ++k) {
    corner_uv[k] = texelFetch(uvs, int(texelFetch(corners, 3 * gl_PrimitiveIDIn + k).x)).xy;
    if (corner_uv[k].x < -1e30) in_image = 0;
  }
  int all = in_image;
  for (int k = 0; k < 3; ++k) {
    at = vertex_at[k];
    scene_normal = vertex_normal[k];
    corner_painted = vertex_painted[k];
    hard = vertex_hard[k];
    uv = corner_uv[k];
    in_image = all;
    gl_Position = gl_in[k].gl_Position;
    EmitVertex();
  }
  EndPrimitive();
})";
constexpr const char* kOwnPaint = R"(
in vec3 corner_painted;
in vec2 uv;
flat in int in_image;
uniform sampler2D image;
uniform int times_painted;
vec3 own_paint() {
  vec3 texel = texture(image, uv).rgb, factor = times_painted == 1 ? corner_painted : vec3(1.0);
  return in_image == 1 ? factor * texel : factor;
}
)";

/// Renames the outputs to the geometry shader's inputs.
std::string renamed(const std::string& vertex) {
  const std::size_t after_version = vertex.find('\n') + 1;
  return vertex.substr(0, after_version) +
         "#define at vertex_at\n#define scene_normal vertex_normal\n#define painted vertex_painted\n#define hard "
         "vertex_hard\n" +
         vertex.substr(after_version);
}

/// Makes mipmaps. Surfaces with the same picture share it.
std::shared_ptr<GlTexture> shared_image(const std::shared_ptr<const Picture>& picture) {
  static thread_local std::map<const Picture*, std::weak_ptr<GlTexture>> known;
  std::erase_if(known, [](const auto& entry) { return entry.second.expired(); });
  std::weak_ptr<GlTexture>& kept = known[picture.get()];
  if (auto image = kept.lock()) return image;
  const auto image = std::make_shared<GlTexture>();
  kept = image;
  glBindTexture(GL_TEXTURE_2D, image->id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8, picture->width, picture->height, 0, GL_RGB, GL_UNSIGNED_BYTE,
               picture->rgb.data());
  glGenerateMipmap(GL_TEXTURE_2D);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  if (epoxy_has_gl_extension("GL_EXT_texture_filter_anisotropic"))
    glTexParameterf(GL_TEXTURE_2D, GL_TEXTURE_MAX_ANISOTROPY_EXT, kAnisotropy);
  return image;
}

template <typename T>
void send(GlBuffer& buffer, const VersionedBlocks<T>& blocks, std::uint64_t had) {
  buffer.update(std::span<const T>(blocks.values), blocks.versions, VersionedBlocks<T>::kBlock, had);
}

}  // namespace

void GlTriangles::follow(const SurfaceGeometry& geometry) {
  if (std::exchange(maker_, geometry.maker) != geometry.maker) count_ = 0, version_ = 0;
  if (geometry.topology_version == version_) return;
  const std::uint64_t had = std::exchange(version_, geometry.topology_version);
  const std::span<const std::uint32_t> indices = geometry.drawn_triangles();
  count_ = static_cast<GLsizei>(indices.size());
  buffer_.update(indices, std::span(geometry.triangle_blocks), LevelTriangles::kBlock, had);
}

void GlSurface::place(const glm::mat4& scene_from_surface) {
  scene_from_surface_ = scene_from_surface;
  const glm::mat3 linear(scene_from_surface);
  // The cofactors are right for mirrors, shears and flattening, too.
  scene_from_normal_ =
      glm::mat3(glm::cross(linear[1], linear[2]), glm::cross(linear[2], linear[0]), glm::cross(linear[0], linear[1]));
  const float determinant = glm::determinant(linear);
  is_mirrored_ = determinant < 0;
  if (is_mirrored_) scene_from_normal_ = -scene_from_normal_;
  scale_ = std::cbrt(std::abs(determinant));
}

void GlSurface::upload(const SurfaceGeometry& geometry) {
  const bool other_maker = std::exchange(maker_, geometry.maker) != geometry.maker;
  const bool other_gpu = std::exchange(gpu_, geometry.gpu.get()) != geometry.gpu.get();
  if (other_maker || other_gpu) pose_version_ = level_version_ = topology_version_ = 0;
  if (corners_ != geometry.corners) {
    corners_ = geometry.corners;
    pose_version_ = paint_version_ = 0;
  }
  extras_ = corners_ ? corners_->origins(geometry.vertex_count()) : std::span<const std::uint32_t>();
  is_point_cloud_ = geometry.is_point_cloud;
  is_solid_ = geometry.is_solid;
  spacing_ = geometry.point_spacing;
  glBindVertexArray(array_.id());
  if (const auto had = std::exchange(pose_version_, geometry.pose_version); had != geometry.pose_version)
    take_pose(geometry, had);
  if (const auto had = std::exchange(level_version_, geometry.level_version); had != geometry.level_version)
    take_radii(geometry, had);
  if (std::exchange(topology_version_, geometry.topology_version) != geometry.topology_version)
    take_triangles(geometry);
}

void GlSurface::take_pose(const SurfaceGeometry& geometry, std::uint64_t had) {
  vertex_count_ = static_cast<GLsizei>(geometry.vertex_count());
  const GpuSurface* gpu = geometry.gpu.get();
  bounds_.reset();
  if (gpu == nullptr) {
    bounds_.emplace();
    const std::vector<float>& at = geometry.positions;
    for (std::size_t i = 0; i + 2 < at.size(); i += 3) bounds_->add({at[i], at[i + 1], at[i + 2]});
    send(positions_, geometry.positions, 3, geometry.position_blocks, had);
    send(normals_, geometry.normals, 3, geometry.normal_blocks, had);
    const std::span<const float> extra_normals(geometry.extra_normals);
    if (corners_)
      normals_.update(extra_normals, std::span(geometry.extra_blocks), LevelTriangles::kBlock, had,
                      3 * sizeof(float) * corners_->vertices());
  }
  const bool has_normals = gpu != nullptr ? gpu->has_normals : !geometry.normals.empty();
  set_array(kPosition, (gpu != nullptr ? gpu->drawn() : positions_).id(), 3,
            gpu != nullptr ? GpuSurface::kPositionBytes : 0);
  if (has_normals) return set_array(kNormal, (gpu != nullptr ? gpu->normals : normals_).id(), 3, 0);
  glDisableVertexAttribArray(kNormal);
  glVertexAttrib3f(kNormal, 0, 0, 0);
}

void GlSurface::take_radii(const SurfaceGeometry& geometry, std::uint64_t had) {
  has_discs_ = !geometry.radii.empty();
  largest_radius_ = has_discs_ ? *std::max_element(geometry.radii.begin(), geometry.radii.end()) : 0;
  if (!has_discs_) return glDisableVertexAttribArray(kRadius);
  send(radii_, geometry.radii, 1, geometry.radius_blocks, had);
  set_array(kRadius, radii_.id(), 1, 0);
}

void GlSurface::take_triangles(const SurfaceGeometry& geometry) {
  if (!geometry.gpu) triangles_.follow(geometry);
  const GlTriangles& triangles = geometry.gpu ? geometry.gpu->triangles : triangles_;
  index_count_ = triangles.count();
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, triangles.buffer());
}

/// And those of extra normals, from the first vertex that may have changed.
void GlSurface::send(GlBuffer& buffer, std::span<const float> values, std::size_t floats, const BlockVersions& versions,
                     std::uint64_t had) {
  const bool all = versions.empty() || had == 0;
  if (!corners_ && all) return buffer.replace(values);
  if (corners_ && all) buffer.renew(floats * sizeof(float) * corners_->parents().size());
  buffer.update(values, std::span(versions), LevelTriangles::kBlock, had);
  if (!corners_ || values.empty()) return;
  const auto changed = std::find_if(versions.begin(), versions.end(), [&](std::uint64_t v) { return v > had; });
  const std::size_t vertex =
      all ? 0 : static_cast<std::size_t>(changed - versions.begin()) * LevelTriangles::kBlock / floats;
  const auto first = std::lower_bound(extras_.begin(), extras_.end(), vertex);
  room_.clear();
  for (auto v = first; v != extras_.end(); ++v)
    room_.insert(room_.end(), &values[floats * *v], &values[floats * *v] + floats);
  const std::size_t before = corners_->vertices() + static_cast<std::size_t>(first - extras_.begin());
  buffer.write(floats * sizeof(float) * before, std::span<const float>(room_));
}

std::optional<Bounds> GlSurface::bounds() const {
  if (!bounds_) return std::nullopt;
  const glm::vec3 around(is_point_cloud_ ? std::max(largest_radius_, 1.2F * spacing_) : 0.4F * spacing_);
  Bounds all;
  for (const glm::vec3& corner : Bounds{bounds_->low - around, bounds_->high + around}.corners())
    all.add(glm::vec3(scene_from_surface_ * glm::vec4(corner, 1)));
  return all;
}

void GlSurface::draw_front_triangles() const {
  if (is_solid_) glEnable(GL_CULL_FACE);
  glFrontFace(is_mirrored_ ? GL_CW : GL_CCW);
  draw_triangles();
  glFrontFace(GL_CCW);
  glDisable(GL_CULL_FACE);
}

void GlSurface::paint(const SurfacePaint& paint) {
  if (paint.version == paint_version_) return;
  const std::uint64_t had = std::exchange(paint_version_, paint.version);
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
  send(values_, paint.values, numbers ? 1 : 3, paint.value_blocks, had);
  set_array(kPaint, values_.id(), numbers ? 1 : 3, 0);
}

void GlSurface::bind(const GlProgram& program) const {
  program.set("colourfulness", colourfulness);
  program.set("scene_from_surface", scene_from_surface_);
  program.set("scene_from_normal", scene_from_normal_);
  glBindVertexArray(array_.id());
}

void GlTexturePaint::follow(const SurfacePaint& paint) {
  const TextureLevels& levels = *paint.levels;
  if (levels_ != &levels) version_ = 0;
  levels_ = &levels;
  send(corners_, levels.corners(), version_);
  send(uvs_, levels.uvs(), version_);
  version_ = levels.version();
  times_values_ = paint.times_values;
  if (picture_ != paint.image) {
    picture_ = paint.image;
    image_ = shared_image(picture_);
  }
}

void GlTexturePaint::bind(const GlProgram& program) const {
  program.set("times_painted", times_values_ ? 1 : 0);
  program.set("image", kImageUnit);
  program.set("corners", kCornersUnit);
  program.set("uvs", kUvsUnit);
  bind_texture(kImageUnit, GL_TEXTURE_2D, image_->id());
  bind_texture(kCornersUnit, GL_TEXTURE_BUFFER, corners_texture_.id());
  glTexBuffer(GL_TEXTURE_BUFFER, GL_R32UI, corners_.id());
  bind_texture(kUvsUnit, GL_TEXTURE_BUFFER, uvs_texture_.id());
  glTexBuffer(GL_TEXTURE_BUFFER, GL_RG32F, uvs_.id());
  glActiveTexture(GL_TEXTURE0);
}

GlProgram::Shaders textured_shaders(const std::string& vertex, const std::string& before_fragment,
                                    const std::string& fragment) {
  return {renamed(vertex), kGeometry, before_fragment + kOwnPaint + fragment};
}

}  // namespace eigencast
