// SPDX-License-Identifier: MIT
#include "common/spectral/laplacian.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "common/core/histogram.h"
#include "common/spectral/bridges.h"
#include "common/spectral/intrinsic_triangles.h"
#include "common/spectral/local_delaunay.h"
#include "common/spectral/point_kernel.h"
#include "common/surface/checks/check.h"
#include "common/surface/edge_uses.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

using Triplets = std::vector<Eigen::Triplet<double>>;

constexpr double kMollification = 1e-5;     // of the mean edge
constexpr double kNoArea = 1e-12;           // of the squared diagonal
constexpr double kMinMass = 1e-6;           // of the median, for vertices of tiny faces
constexpr double kUnreferencedMass = 1e-3;  // of the median
constexpr double kSpring = 0.6;             // a typical cotangent weight, independent of scale

double distance(const Vec3& a, const Vec3& b) {
  return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

EdgeLengths lengths_of(std::span<const Vec3> positions, const Face& f) {
  return {distance(positions[f[1]], positions[f[2]]), distance(positions[f[2]], positions[f[0]]),
          distance(positions[f[0]], positions[f[1]])};
}

/// The length that every edge gains so that no face is degenerate: 0 on good meshes.
double mollification(const std::vector<EdgeLengths>& lengths) {
  double sum = 0;
  for (const EdgeLengths& l : lengths) sum += l[0] + l[1] + l[2];
  const double delta = kMollification * sum / (3 * static_cast<double>(lengths.size()));
  double epsilon = 0;
  for (const EdgeLengths& l : lengths) {
    const double longest = std::max({l[0], l[1], l[2]});
    epsilon = std::max(epsilon, delta + 2 * longest - (l[0] + l[1] + l[2]));
  }
  return epsilon;
}

void add_spring(std::uint32_t a, std::uint32_t b, double weight, Triplets& entries) {
  const int i = static_cast<int>(a);
  const int j = static_cast<int>(b);
  entries.emplace_back(i, i, weight);
  entries.emplace_back(j, j, weight);
  entries.emplace_back(i, j, -weight);
  entries.emplace_back(j, i, -weight);
}

struct Assembly {
  Triplets entries;
  Eigen::VectorXd mass;  // 0 where no face is
  double area = 0;       // before mollification
  std::optional<std::size_t> flips;
};

/// Adds cotangent weights from edge lengths alone and a third of each face's area to its corners, all times `scale`.
void add_faces(std::span<const Face> faces, std::span<const EdgeLengths> lengths, double scale, Assembly& assembly) {
  assembly.entries.reserve(assembly.entries.size() + 12 * faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const EdgeLengths& l = lengths[f];
    const double area = area_from_lengths(l);
    if (!(area > 0)) continue;  // only when all faces are points
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t j = (i + 1) % 3;
      const std::size_t k = (i + 2) % 3;
      const double cotangent = (l[j] * l[j] + l[k] * l[k] - l[i] * l[i]) / (4 * area);
      add_spring(faces[f][j], faces[f][k], scale * cotangent / 2, assembly.entries);
      assembly.mass[faces[f][i]] += scale * area / 3;
    }
  }
}

/// Assembles faces of three different corners, as they are or as Delaunay triangles of their tufted cover.
Assembly assemble(std::span<const Vec3> positions, std::span<const Face> faces, double scale, bool delaunay) {
  Assembly result;
  result.mass = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(positions.size()));
  std::vector<EdgeLengths> lengths;
  lengths.reserve(faces.size());
  for (const Face& f : faces) lengths.push_back(lengths_of(positions, f));
  if (lengths.empty()) return result;
  const double epsilon = mollification(lengths);
  for (const Face& f : faces) {
    const Vec3& corner = positions[f[0]];
    result.area += scale / 2 * length(cross(positions[f[1]] - corner, positions[f[2]] - corner));
  }
  for (EdgeLengths& l : lengths) {
    for (double& edge : l) edge += epsilon;
  }
  if (!delaunay) {
    add_faces(faces, lengths, scale, result);
    return result;
  }
  const IntrinsicTriangles cover = delaunay_cover(positions, faces, lengths);
  add_faces(cover.faces, cover.lengths, scale / 2, result);
  result.flips = cover.flips;
  return result;
}

/// The median of the positive masses.
double median_mass(const Eigen::VectorXd& mass) {
  std::vector<double> positive;
  for (const double m : mass) {
    if (m > 0) positive.push_back(m);
  }
  return positive.empty() ? 0 : median(std::move(positive));
}

std::vector<Face> faces_with_three_corners(const Surface& surface) {
  std::vector<Face> result;
  std::copy_if(surface.faces.begin(), surface.faces.end(), std::back_inserter(result),
               [&](const Face& face) { return has_three_corners(face, surface.vertex_count()); });
  return result;
}

/// Replaces the triangles of a cloud by the kernel; keeps the area.
void use_kernel(const PointKernel& kernel, Assembly& assembly) {
  assembly.entries.clear();
  assembly.entries.reserve(4 * kernel.pairs.size());
  for (const auto& [a, b, weight] : kernel.pairs) add_spring(a, b, weight, assembly.entries);
  assembly.mass = Eigen::Map<const Eigen::VectorXd>(kernel.area.data(), assembly.mass.size());
}

/// Coincident points share the mass of the first one and hang on it by a spring.
void attach_coincident(const LocalTriangles& local, Assembly& assembly) {
  std::vector<std::uint32_t> copies(static_cast<std::size_t>(assembly.mass.size()), 1);
  for (const auto& [copy, leader] : local.coincident) {
    add_spring(copy, leader, 1.0, assembly.entries);
    ++copies[leader];
  }
  for (std::size_t i = 0; i < copies.size(); ++i) assembly.mass[static_cast<Eigen::Index>(i)] /= copies[i];
  for (const auto& [copy, leader] : local.coincident) assembly.mass[copy] = assembly.mass[leader];
}

Eigen::SparseMatrix<double> matrix_from(Eigen::Index n, const Triplets& entries) {
  Eigen::SparseMatrix<double> L(n, n);
  L.setFromTriplets(entries.begin(), entries.end());
  return L;
}

}  // namespace

Result<Laplacian> build_laplacian(const Surface& surface, const LaplacianOptions& options) {
  if (auto valid = validate_surface(surface); !valid) return valid.error();
  const bool cloud = surface.is_point_cloud();
  Assembly assembly;
  if (cloud) {
    const LocalTriangles local = local_delaunay(surface.positions);
    assembly = assemble(surface.positions, local.faces, 1.0 / 3, false);
    if (options.points == PointsOperator::kPbMhb) use_kernel(point_kernel(surface.positions, local), assembly);
    attach_coincident(local, assembly);
  } else {
    const std::vector<Face> faces = faces_with_three_corners(surface);
    const bool delaunay = options.delaunay || has_edge_of_many_faces(faces, surface.vertex_count());
    assembly = assemble(surface.positions, faces, 1.0, delaunay);
  }
  const double diagonal = bounding_box(surface.positions).diagonal();
  const double median = median_mass(assembly.mass);
  if (!(assembly.area > kNoArea * diagonal * diagonal) || !(median > 0)) {
    return fail(ErrorCode::kNumerical,
                cloud ? "the points lie on a line or on one another and span no surface: there is nothing to stream"
                      : "no face has an area: there is nothing to stream; check that the file's faces are right");
  }

  Laplacian result;
  result.flips = assembly.flips;
  const Eigen::Index n = static_cast<Eigen::Index>(surface.vertex_count());
  const double min_mass = (cloud ? kUnreferencedMass : kMinMass) * median;
  result.mass =
      assembly.mass.unaryExpr([&](double m) { return m > 0 ? std::max(m, min_mass) : kUnreferencedMass * median; });
  result.area = result.mass.sum();
  result.L = matrix_from(n, assembly.entries);
  ComponentLabels labels = components_from_pattern(result.L);
  result.components = static_cast<int>(labels.count);
  if (options.bridge && labels.count > 1) {
    const auto bridges = find_bridges(surface.positions, std::move(labels));
    for (const auto& [a, b] : bridges) add_spring(a, b, kSpring, assembly.entries);
    result.bridges = static_cast<int>(bridges.size());
    result.L = matrix_from(n, assembly.entries);
  }
  if (!result.mass.allFinite() ||
      !Eigen::Map<const Eigen::ArrayXd>(result.L.valuePtr(), result.L.nonZeros()).allFinite()) {
    return fail(ErrorCode::kNumerical,
                "the surface's coordinates are too large or too small to compute areas; rescale it");
  }
  return result;
}

}  // namespace eigencast
