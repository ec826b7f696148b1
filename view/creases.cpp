// SPDX-License-Identifier: MIT
#include "view/creases.h"

#include <algorithm>
#include <cmath>

#include "common/surface/edge_uses.h"
#include "common/surface/vector.h"

namespace eigencast {

std::vector<float> crease_angles(std::span<const Face> faces, std::span<const float> positions, bool* is_solid) {
  constexpr float kFolded = 3.14159265F;
  std::vector<float> angles(positions.size() / 3, 0);
  const auto point = [&](std::uint32_t v) {
    const float* p = &positions[std::size_t{3} * v];
    return Vec3{p[0], p[1], p[2]};
  };
  std::vector<Vec3> normals;
  normals.reserve(faces.size());
  for (const auto& [a, b, c] : faces) normals.push_back(unit(cross(point(b) - point(a), point(c) - point(a))));
  const std::vector<EdgeUse> uses = edge_uses(faces, angles.size());
  bool closed = uses.size() == 3 * faces.size();
  for_each_edge(std::span(uses), [&](std::span<const EdgeUse> edge) {
    closed = closed && edge.size() == 2 && edge[0].upwards != edge[1].upwards;
    if (edge.size() < 2) return;
    const Vec3 &one = normals[edge[0].face], &other = normals[edge[1].face];
    if (edge.size() == 2 && (dot(one, one) == 0 || dot(other, other) == 0)) return;
    const double same_winding = edge[0].upwards == edge[1].upwards ? -1 : 1;
    const auto bend = static_cast<float>(std::acos(std::clamp(same_winding * dot(one, other), -1.0, 1.0)));
    for (const std::uint32_t v : {edge[0].low, edge[0].high})
      angles[v] = std::max(angles[v], edge.size() > 2 ? kFolded : bend);
  });
  if (is_solid == nullptr) return angles;
  double volume = 0;  // sixfold
  for (const auto& [a, b, c] : faces) volume += dot(point(a), cross(point(b), point(c)));
  *is_solid = closed && volume > 0;
  return angles;
}

}  // namespace eigencast
