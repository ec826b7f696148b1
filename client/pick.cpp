// SPDX-License-Identifier: MIT
#include "client/pick.h"

#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <span>
#include <vector>

namespace eigencast {
namespace {

struct Ray {
  glm::vec3 from{0}, to{0};  ///< Towards `to`, not unit length: parameters are the same in every space.
};

glm::vec3 vertex(std::span<const float> positions, std::size_t i) {
  return {positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
}

/// Moeller, Trumbore 1997, "Fast, minimum storage ray-triangle intersection"; both sides count.
std::optional<float> hit_triangle(const Ray& ray, const glm::vec3& a, const glm::vec3& b, const glm::vec3& c) {
  const glm::vec3 along = ray.to - ray.from, ab = b - a, ac = c - a, p = glm::cross(along, ac);
  const float determinant = glm::dot(ab, p);
  if (determinant == 0) return std::nullopt;
  const glm::vec3 s = ray.from - a, q = glm::cross(s, ab);
  const float u = glm::dot(s, p) / determinant, v = glm::dot(along, q) / determinant;
  const float t = glm::dot(ac, q) / determinant;
  if (u < 0 || v < 0 || u + v > 1 || t <= 0) return std::nullopt;
  return t;
}

std::optional<float> hit_point(const Ray& ray, const glm::vec3& point, float radius) {
  const glm::vec3 along = ray.to - ray.from;
  const float t = glm::dot(point - ray.from, along) / glm::dot(along, along);
  if (t <= 0 || glm::length(ray.from + t * along - point) > radius) return std::nullopt;
  return t;
}

}  // namespace

std::optional<glm::vec3> pick(const Scene& scene, const Camera& camera, const glm::vec2& at_px, int width_px,
                              int height_px) {
  if (width_px < 1 || height_px < 1) return std::nullopt;
  const glm::mat4 scene_from_clip = glm::inverse(camera.clip_from_view() * camera.view_from_scene());
  const glm::vec4 far = scene_from_clip * glm::vec4(2 * at_px.x / static_cast<float>(width_px) - 1,
                                                    1 - 2 * at_px.y / static_cast<float>(height_px), 0.5F, 1);
  const Ray in_scene{camera.position(), glm::vec3(far) / far.w};
  std::optional<float> nearest;
  std::vector<float> room;
  const auto take = [&](const std::optional<float>& t) {
    if (t && (!nearest || *t < *nearest)) nearest = t;
  };
  for (const Scene::Instance& instance : scene.instances()) {
    const SurfaceGeometry& g = instance.view.geometry();
    if (!instance.visible || g.vertex_count() == 0) continue;
    const std::span<const float> X = instance.view.positions(room);
    const glm::mat4 surface_from_scene = glm::inverse(instance.scene_from_surface);
    const Ray ray{glm::vec3(surface_from_scene * glm::vec4(in_scene.from, 1)),
                  glm::vec3(surface_from_scene * glm::vec4(in_scene.to, 1))};
    for (std::size_t i = 0; g.is_point_cloud && i < g.vertex_count(); ++i)
      take(hit_point(ray, vertex(X, i), 1.2F * g.point_spacing));
    for (std::size_t f = 0; f + 2 < g.triangles.size(); f += 3)
      take(hit_triangle(ray, vertex(X, g.triangles[f]), vertex(X, g.triangles[f + 1]), vertex(X, g.triangles[f + 2])));
  }
  if (!nearest) return std::nullopt;
  return in_scene.from + *nearest * (in_scene.to - in_scene.from);
}

}  // namespace eigencast
