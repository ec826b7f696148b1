// SPDX-License-Identifier: MIT
#include "view/surroundings.h"

#include <algorithm>
#include <array>
#include <glm/geometric.hpp>
#include <string>

#include "view/shaders.h"

namespace eigencast {

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
