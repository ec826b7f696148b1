// SPDX-License-Identifier: MIT
#include "view/surroundings.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <string>
#include <utility>
#include <vector>

#include "view/gl_surface.h"
#include "view/shaders.h"

namespace eigencast {
namespace {

constexpr float kReach = 2.2F;  // of the shadow map, in radii: a deforming surface leaves its rest box
constexpr int kSquare = 8;      // texels of the shadow map in one of its range, along each side
/// Of points without discs, in spacings: from the light, where sprites that face it are not above their neighbours.
constexpr float kSpriteBehind = 2;
constexpr glm::vec3 kClay{0.70F, 0.185F, 0.115F};
constexpr glm::vec3 kClayInside{0.34F, 0.21F, 0.18F};

glm::vec3 light_beside(const Camera& camera, float right, float above, float behind) {
  const glm::vec3 back = glm::normalize(camera.position() - camera.target());
  const glm::vec3 side = glm::normalize(glm::cross(camera.up_vector(), back));
  const glm::vec3 level = glm::cross(side, camera.up_vector());
  return glm::normalize(right * side + above * camera.up_vector() + behind * level);
}

/// For wide tents. On surfaces, which are narrow in the map, the range of depths rarely decides.
std::string lighting_by_range() {
  std::string shader = shaders::kLighting;
  shader.insert(shader.find("  while (to.y"), shaders::kShadowRange);
  return shader.insert(shader.find("float lit_by_key"), "uniform sampler2D shadow_range;\n");
}

}  // namespace

Result<void> Lighting::init() {
  auto built = shadow_.build("shadow", {shaders::kShadowVertex, {}, shaders::kShadowFragment});
  if (built)
    built = disc_shadow_.build("discs' shadow", {shaders::kDiscShadowVertex, {}, shaders::kDiscShadowFragment});
  if (built) built = range_of_.build("shadow's range", {shaders::kScreenVertex, {}, shaders::kShadowRangeFragment});
  if (!built) return built;
  glBindTexture(GL_TEXTURE_2D, range_.id());
  set_filter(GL_NEAREST);
  glBindTexture(GL_TEXTURE_2D, shadows_.id());
  set_filter(GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  return {};
}

void Lighting::cast(const Camera& camera, std::span<const std::unique_ptr<GlSurface>> surfaces, ShadowQuality quality) {
  quality_ = quality;
  key_ = light_beside(camera, -0.62F, 1.15F, 0.62F);
  fill_ = light_beside(camera, 0.9F, 0.15F, 0.45F);
  const glm::vec3 centre = camera.scene_centre(), up = camera.up_vector();
  const float reach = kReach * camera.scene_radius();
  const glm::vec3 beside = std::abs(glm::dot(key_, up)) > 0.99F ? glm::vec3(up.y, up.z, up.x) : up;
  const glm::mat4 light = glm::lookAt(centre + 2 * reach * key_, centre, beside);
  light_from_scene_ = glm::ortho(-reach, reach, -reach, reach, 0.0F, 4 * reach) * light;
  casters_.emplace();
  for (const auto& surface : surfaces) {
    if (!surface->drawable() || !casters_) continue;
    const std::optional<Bounds> bounds = surface->bounds();
    if (!bounds) {
      casters_.reset();
    } else {
      casters_->add(bounds->low);
      casters_->add(bounds->high);
    }
  }
  if (quality == ShadowQuality::kNone) return;

  const int side = quality == ShadowQuality::kFull ? 512 : 256;
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  if (std::exchange(side_, side) != side) {
    bind_texture(0, GL_TEXTURE_2D, shadows_.id());
    glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT24, side, side, 0, GL_DEPTH_COMPONENT, GL_FLOAT, nullptr);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, shadows_.id(), 0);
    bind_texture(0, GL_TEXTURE_2D, range_.id());
    glBindFramebuffer(GL_FRAMEBUFFER, range_framebuffer_.id());
    glTexImage2D(GL_TEXTURE_2D, 0, GL_RG32F, side / kSquare, side / kSquare, 0, GL_RG, GL_FLOAT, nullptr);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, range_.id(), 0);
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  }
  glViewport(0, 0, side, side);
  glDepthMask(GL_TRUE);
  glClear(GL_DEPTH_BUFFER_BIT);
  glEnable(GL_DEPTH_TEST);
  glEnable(GL_PROGRAM_POINT_SIZE);
  const float px_per_unit = static_cast<float>(side) / (2 * reach);
  disc_shadow_.use();
  disc_shadow_.set("light_from_scene", light_from_scene_);
  disc_shadow_.set("light_turn", glm::mat3(light));
  disc_shadow_.set("px_per_unit", px_per_unit);
  disc_shadow_.set("depth_per_unit", 1 / (4 * reach));
  for (const auto& surface : surfaces) {
    if (!surface->drawable() || !surface->is_point_cloud() || !surface->has_discs()) continue;
    disc_shadow_.set("discs", surface->scale());
    surface->bind(disc_shadow_);
    surface->draw_points();
  }
  shadow_.use();
  for (const auto& surface : surfaces) {
    if (!surface->drawable() || (surface->is_point_cloud() && surface->has_discs())) continue;
    surface->bind(shadow_);
    const float behind = surface->is_point_cloud() ? kSpriteBehind * surface->spacing() : 0;
    shadow_.set("light_from_scene", glm::translate(light_from_scene_, -behind * key_));
    if (surface->is_point_cloud()) {
      shadow_.set("point_px", std::max(1.0F, 2 * surface->spacing() * px_per_unit));
      surface->draw_points();
    } else {
      surface->draw_front_triangles();
    }
  }
  find_range();
}

void Lighting::find_range() {
  const int squares = side_ / kSquare;
  glBindFramebuffer(GL_FRAMEBUFFER, range_framebuffer_.id());
  glViewport(0, 0, squares, squares);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_BLEND);
  glClearColor(1, 1, 0, 0);
  glClear(GL_COLOR_BUFFER_BIT);
  const PixelBox part =
      casters_ ? casters_->empty() ? PixelBox() : pixels_of(casters_->corners(), light_from_scene_, squares, squares, 2)
               : PixelBox{0, 0, squares, squares};
  if (part.empty()) return;
  glEnable(GL_SCISSOR_TEST);
  glScissor(part.x, part.y, part.width, part.height);
  bind_texture(0, GL_TEXTURE_2D, shadows_.id());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_COMPARE_MODE, GL_NONE);
  range_of_.use();
  range_of_.set("shadow_map", 0);
  glBindVertexArray(none_.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glDisable(GL_SCISSOR_TEST);
}

PixelBox Lighting::shadow_on(const Camera& camera, float level, int width_px, int height_px) const {
  if (quality_ == ShadowQuality::kNone || (casters_ && casters_->empty())) return {};
  const glm::vec3 up = camera.up_vector(), side = glm::vec3(up.y, up.z, up.x), other = glm::cross(up, side);
  const float fall = glm::dot(key_, up), blur = 10.0F / 512 * kReach * camera.scene_radius();
  if (!casters_ || fall < 0.05F) return {0, 0, width_px, height_px};
  std::vector<glm::vec3> edge;
  for (const glm::vec3& corner : casters_->corners()) {
    const glm::vec3 below = corner - (glm::dot(corner, up) - level) / fall * key_;
    for (const glm::vec3& around : {side + other, side - other, other - side, -side - other})
      edge.push_back(below + blur / fall * around);
  }
  return pixels_of(edge, camera.clip_from_view() * camera.view_from_scene(), width_px, height_px, 1);
}

void Lighting::light(const GlProgram& program, const Camera& camera) const {
  program.use();
  program.set("shadow_map", 0);
  program.set("shadow_range", static_cast<int>(kRangeUnit));
  program.set("light_from_scene", light_from_scene_);
  program.set("clip_from_scene", camera.clip_from_view() * camera.view_from_scene());
  program.set("eye", camera.position());
  program.set("up", camera.up_vector());
  program.set("key_light", key_);
  program.set("fill_light", fill_);
  program.set("albedo", kClay);
  program.set("albedo_inside", kClayInside);
  program.set("normal_offset", 0.018F * camera.scene_radius());
}

Result<void> Surroundings::init() {
  const std::string ground = lighting_by_range() + shaders::kGroundFragment;
  auto built = wall_.build("wall", {shaders::kScreenVertex, {}, shaders::kBackgroundFragment});
  if (built) built = floor_.init("floor", {shaders::kGroundVertex, {}, ground}, {"shadow_saving"});
  if (built) built = line_.build("axes", {shaders::kMeshVertex, {}, shaders::kLineFragment});
  if (!built) return built;
  glBindVertexArray(axes_.id());
  glBindBuffer(GL_ARRAY_BUFFER, ends_.id());
  glVertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, 0, nullptr);
  glEnableVertexAttribArray(0);
  return {};
}

void Surroundings::draw_wall() const {
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_BLEND);
  wall_.use();
  glBindVertexArray(none_.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void Surroundings::draw_floor(const Camera& camera, const Lighting& lighting, const Floor& floor) {
  const glm::vec3 up = camera.up_vector();
  const float radius = camera.scene_radius(), level = glm::dot(camera.scene_low(), up) - 0.02F * radius;
  if (glm::dot(camera.position(), up) <= level) return;  // seen from below it would hide the surface
  const PixelBox shadow = lighting.shadow_on(camera, level, floor.width_px, floor.height_px);
  glEnable(GL_BLEND);
  glEnable(GL_SCISSOR_TEST);
  glDepthMask(GL_FALSE);
  glBindVertexArray(none_.id());
  const auto draw = [](const PixelBox& part) {
    if (part.empty()) return;
    glScissor(part.x, part.y, part.width, part.height);
    glDrawArrays(GL_TRIANGLE_STRIP, 0, 4);
  };
  use_floor(camera, lighting, floor, level, ShadowQuality::kNone);
  for (const PixelBox& part : shadow.around(floor.width_px, floor.height_px)) draw(part);
  use_floor(camera, lighting, floor, level, lighting.quality());
  draw(shadow);
  glDepthMask(GL_TRUE);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_BLEND);
}

void Surroundings::use_floor(const Camera& camera, const Lighting& lighting, const Floor& floor, float level,
                             ShadowQuality shadow) {
  const glm::vec3 up = camera.up_vector(), centre = camera.scene_centre();
  const glm::vec3 a = glm::vec3(up.y, up.z, up.x), extent = camera.scene_high() - camera.scene_low();
  const float reach = 4 * camera.scene_radius();
  const float across = std::max(glm::length(extent - glm::dot(extent, up) * up), 0.05F * reach);
  const GlProgram& program = floor_.with({static_cast<int>(shadow)});
  lighting.light(program, camera);
  program.set("ground_centre", centre + (level - glm::dot(centre, up)) * up);
  program.set("ground_a", reach * a);
  program.set("ground_b", reach * glm::cross(up, a));
  program.set("grid_cells", 20.0F);
  program.set("grid_strength", floor.grid ? 1.0F : 0.0F);
  program.set("pixel_scale", floor.pixel_scale);
  program.set("contact_radius", floor.shadow ? 0.5F * across / reach : 1e-4F);
}

void Surroundings::draw_axes(const Camera& camera, float pixel_scale) const {
  const glm::vec3 from = camera.scene_centre();
  line_.use();
  line_.set("clip_from_scene", camera.clip_from_view() * camera.view_from_scene());
  line_.set("scene_from_surface", glm::mat4(1));
  glBindVertexArray(axes_.id());
  glDisable(GL_DEPTH_TEST);
  set_line_width(pixel_scale);
  for (int axis = 0; axis < 3; ++axis) {
    glm::vec3 to = from;
    to[axis] += 1.15F * camera.scene_radius();
    const std::array<glm::vec3, 2> ends{from, to};
    glBindBuffer(GL_ARRAY_BUFFER, ends_.id());
    glBufferData(GL_ARRAY_BUFFER, sizeof ends, ends.data(), GL_STREAM_DRAW);
    glm::vec4 colour(0.15F, 0.15F, 0.15F, 1);
    colour[axis] = 0.8F;
    line_.set("line_colour", colour);
    glDrawArrays(GL_LINES, 0, 2);
  }
}

}  // namespace eigencast
