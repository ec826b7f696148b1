// SPDX-License-Identifier: MIT
#include "sender/deform/rigidity.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <map>

#include "common/surface/vector.h"

namespace eigencast::deform {
namespace {

// Of the largest angle's cotangent: obtuse and degenerate triangles would repel or tear without it.
constexpr double kMinWeight = 1e-3, kMaxWeight = 1e3;

}  // namespace

std::vector<std::vector<Neighbour>> cotangent_neighbours(std::span<const Vec3> positions, std::span<const Face> faces) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, double> edges;
  for (const Face& f : faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = f[(k + 1) % 3], b = f[(k + 2) % 3];
      if (a == b) continue;
      const Vec3 u = positions[a] - positions[f[k]], v = positions[b] - positions[f[k]];
      const double area2 = length(cross(u, v));
      edges[{std::min(a, b), std::max(a, b)}] += area2 > 0 ? 0.5 * dot(u, v) / area2 : 0;
    }
  }
  std::vector<std::vector<Neighbour>> all(positions.size());
  for (const auto& [edge, cotangents] : edges) {
    const double weight = std::clamp(cotangents, kMinWeight, kMaxWeight);
    all[edge.first].push_back({edge.second, weight});
    all[edge.second].push_back({edge.first, weight});
  }
  return all;
}

Eigen::Matrix3d best_rotation(const Eigen::Matrix3d& S) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(S, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d V = svd.matrixV();
  // A rotation, not a reflection: the direction that matters least is turned over.
  if ((V * svd.matrixU().transpose()).determinant() < 0) V.col(2) = -V.col(2);
  return V * svd.matrixU().transpose();
}

}  // namespace eigencast::deform
