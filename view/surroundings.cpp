// SPDX-License-Identifier: MIT
#include "view/surroundings.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <string>

#include "view/gl_surface.h"
#include "view/shaders.h"

namespace eigencast {
namespace {

constexpr int kShadowSide = 1024;
constexpr glm::vec3 kClay{0.70F, 0.185F, 0.115F};
constexpr glm::vec3 kClayInside{0.24F, 0.30F, 0.38F};

glm::vec3 light_beside(const Camera& camera, float right, float above, float behind) {
  const glm::vec3 back = glm::normalize(camera.position() - camera.target());
  const glm::vec3 side = glm::normalize(glm::cross(camera.up_vector(), back));
  const glm::vec3 level = glm::cross(side, camera.up_vector());
  return glm::normalize(right * side + above * camera.up_vector() + behind * level);
}

}  // namespace

Result<void> Lighting::init() {
  const auto built = shadow_.build("shadow", {shaders::kShadowVertex, {}, shaders::kShadowFragment});
  if (!built) return built;
  glBindTexture(GL_TEXTURE_2D, shadows_.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT24, kShadowSide, kShadowSide, 0, GL_DEPTH_COMPONENT, GL_FLOAT,
               nullptr);
  set_filter(GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, shadows_.id(), 0);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  return {};
}

void Lighting::cast(const Camera& camera, std::span<const std::unique_ptr<GlSurface>> surfaces) {
  key_ = light_beside(camera, -0.62F, 1.15F, 0.62F);
  fill_ = light_beside(camera, 0.9F, 0.15F, 0.45F);
  const glm::vec3 centre = camera.scene_centre(), up = camera.up_vector();
  const float reach = 2.2F * camera.scene_radius();  // a deforming surface leaves its rest box
  const glm::vec3 beside = std::abs(glm::dot(key_, up)) > 0.99F ? glm::vec3(up.y, up.z, up.x) : up;
  light_from_scene_ = glm::ortho(-reach, reach, -reach, reach, 0.0F, 4 * reach) *
                      glm::lookAt(centre + 2 * reach * key_, centre, beside);

  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glViewport(0, 0, kShadowSide, kShadowSide);
  glDepthMask(GL_TRUE);
  glClear(GL_DEPTH_BUFFER_BIT);
  glEnable(GL_DEPTH_TEST);
  glEnable(GL_PROGRAM_POINT_SIZE);
  shadow_.use();
  shadow_.set("light_from_scene", light_from_scene_);
  for (const auto& surface : surfaces) {
    if (!surface->drawable()) continue;
    surface->bind(shadow_);
    if (surface->is_point_cloud()) {
      shadow_.set("point_px", std::max(1.0F, surface->spacing() * kShadowSide / reach));
      surface->draw_points();
    } else {
      surface->draw_triangles();
    }
  }
}

void Lighting::light(const GlProgram& program, const Camera& camera) const {
  program.use();
  program.set("shadow_map", 0);
  program.set("light_from_scene", light_from_scene_);
  program.set("shadow_blur", 0.006F);
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
  const std::string ground = std::string(shaders::kLighting) + shaders::kGroundFragment;
  auto built = wall_.build("wall", {shaders::kScreenVertex, {}, shaders::kBackgroundFragment});
  if (built) built = floor_.build("floor", {shaders::kGroundVertex, {}, ground});
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

void Surroundings::draw_floor(const Camera& camera, const Lighting& lighting, const Floor& floor) const {
  const glm::vec3 up = camera.up_vector();
  const float radius = camera.scene_radius(), level = glm::dot(camera.scene_low(), up) - 0.02F * radius;
  if (glm::dot(camera.position(), up) <= level) return;  // seen from below it would hide the surface
  const glm::vec3 a = glm::vec3(up.y, up.z, up.x), b = glm::cross(up, a);
  const glm::vec3 centre = camera.scene_centre(), extent = camera.scene_high() - camera.scene_low();
  const float reach = 4 * radius;
  const float across = std::max(glm::length(extent - glm::dot(extent, up) * up), 0.2F * radius);
  lighting.light(floor_, camera);
  floor_.set("ground_centre", centre + (level - glm::dot(centre, up)) * up);
  floor_.set("ground_a", reach * a);
  floor_.set("ground_b", reach * b);
  floor_.set("grid_cells", 20.0F);
  floor_.set("grid_strength", floor.grid ? 1.0F : 0.0F);
  floor_.set("pixel_scale", floor.pixel_scale);
  floor_.set("contact_radius", floor.shadow ? 0.5F * across / reach : 1e-4F);
  floor_.set("shadow_blur", 0.012F);
  glEnable(GL_BLEND);
  glDepthMask(GL_FALSE);
  glBindVertexArray(none_.id());
  glDrawArrays(GL_TRIANGLE_STRIP, 0, 4);
  glDepthMask(GL_TRUE);
  glDisable(GL_BLEND);
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
