// SPDX-License-Identifier: MIT
#include "view/texture_paint.h"

#include <algorithm>
#include <map>
#include <span>

#include "view/texture_levels.h"

namespace eigencast {
namespace {

/// Texture units; 0 and 1 belong to shadow map and colour table.
constexpr int kImageUnit = 2, kCornersUnit = 3, kUvsUnit = 4;
constexpr float kAnisotropy = 8;

/// Corners of one vertex may have several UVs: only the geometry shader knows whose corner it is.
constexpr const char* kGeometry = R"(#version 330 core
layout(triangles) in;
layout(triangle_strip, max_vertices = 3) out;
in vec3 vertex_at[];
in vec3 vertex_normal[];
in vec3 vertex_painted[];
uniform usamplerBuffer corners;
uniform samplerBuffer uvs;
out vec3 at;
out vec3 scene_normal;
out vec3 corner_painted;
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

/// With the geometry shader's inputs as outputs.
std::string renamed(const std::string& vertex) {
  const std::size_t after_version = vertex.find('\n') + 1;
  return vertex.substr(0, after_version) +
         "#define at vertex_at\n#define scene_normal vertex_normal\n#define painted vertex_painted\n" +
         vertex.substr(after_version);
}

/// Surfaces with the same picture share its image.
std::shared_ptr<GlImage> shared_image(const std::shared_ptr<const Picture>& picture) {
  static thread_local std::map<const Picture*, std::weak_ptr<GlImage>> known;
  std::erase_if(known, [](const auto& entry) { return entry.second.expired(); });
  if (auto image = known[picture.get()].lock()) return image;
  auto image = std::make_shared<GlImage>(*picture);
  known[picture.get()] = image;
  return image;
}

template <typename T>
void send(GlBuffer& buffer, const VersionedBlocks<T>& blocks, std::uint64_t had) {
  buffer.update(std::span<const T>(blocks.values), blocks.versions, VersionedBlocks<T>::kBlock, had);
}

}  // namespace

GlImage::GlImage(const Picture& picture) {
  glBindTexture(GL_TEXTURE_2D, id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8, picture.width, picture.height, 0, GL_RGB, GL_UNSIGNED_BYTE,
               picture.rgb.data());
  glGenerateMipmap(GL_TEXTURE_2D);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  if (epoxy_has_gl_extension("GL_EXT_texture_filter_anisotropic"))
    glTexParameterf(GL_TEXTURE_2D, GL_TEXTURE_MAX_ANISOTROPY_EXT, kAnisotropy);
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
  glActiveTexture(GL_TEXTURE0 + kImageUnit);
  glBindTexture(GL_TEXTURE_2D, image_->id());
  glActiveTexture(GL_TEXTURE0 + kCornersUnit);
  glBindTexture(GL_TEXTURE_BUFFER, corners_texture_.id());
  glTexBuffer(GL_TEXTURE_BUFFER, GL_R32UI, corners_.id());
  glActiveTexture(GL_TEXTURE0 + kUvsUnit);
  glBindTexture(GL_TEXTURE_BUFFER, uvs_texture_.id());
  glTexBuffer(GL_TEXTURE_BUFFER, GL_RG32F, uvs_.id());
  glActiveTexture(GL_TEXTURE0);
}

Result<void> build_textured(GlProgram& program, const std::string& vertex, const std::string& before_fragment,
                            const std::string& fragment) {
  return program.build("textured mesh", {renamed(vertex), kGeometry, before_fragment + kOwnPaint + fragment});
}

}  // namespace eigencast
