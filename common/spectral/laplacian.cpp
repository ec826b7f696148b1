// SPDX-License-Identifier: MIT
#include "common/spectral/laplacian.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <span>
#include <utility>

#include "common/core/histogram.h"
#include "common/core/union_find.h"
#include "common/spectral/intrinsic_triangles.h"
#include "common/spectral/point_operators.h"
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
constexpr std::size_t kPairsPerComponent = 3;
constexpr std::size_t kMaxQueries = 4096;

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

double median_mass(const Eigen::VectorXd& mass) {
  std::vector<double> positive;
  std::copy_if(mass.begin(), mass.end(), std::back_inserter(positive), [](double m) { return m > 0; });
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

ComponentLabels labels_from(UnionFind& sets) {
  ComponentLabels result;
  result.of_vertex.resize(sets.size());
  for (std::uint32_t i = 0; i < sets.size(); ++i) {
    const std::uint32_t root = sets.root(i);
    result.of_vertex[i] = root == i ? result.count++ : result.of_vertex[root];
  }
  return result;
}

struct VertexPair {
  double squared_distance = std::numeric_limits<double>::infinity();
  std::uint32_t from = 0;
  std::uint32_t to = 0;
};

/// A component's nearest pairs so far, ascending, from distinct vertices where it has enough.
class NearestPairs {
 public:
  explicit NearestPairs(bool distinct) : distinct_(distinct) {}
  double worst() const { return pairs_.back().squared_distance; }
  void add(const VertexPair& pair) {
    if (pair.squared_distance >= worst()) return;
    const auto same = std::find_if(pairs_.begin(), pairs_.end(), [&](const VertexPair& p) {
      return std::isfinite(p.squared_distance) && p.from == pair.from && (distinct_ || p.to == pair.to);
    });
    if (same != pairs_.end()) {
      if (pair.squared_distance >= same->squared_distance) return;
      *same = pair;
    } else {
      pairs_.back() = pair;
    }
    std::stable_sort(pairs_.begin(), pairs_.end(),
                     [](const VertexPair& a, const VertexPair& b) { return a.squared_distance < b.squared_distance; });
  }
  const std::array<VertexPair, kPairsPerComponent>& pairs() const { return pairs_; }

 private:
  bool distinct_;
  std::array<VertexPair, kPairsPerComponent> pairs_{};
};

/// A result set for nanoflann that skips the query vertex's own component.
class OtherComponentSet {
 public:
  using DistanceType = double;
  using IndexType = std::uint32_t;
  OtherComponentSet(const std::vector<std::uint32_t>& labels, std::uint32_t from, NearestPairs& found)
      : labels_(labels), from_(from), found_(found) {}
  std::size_t size() const { return 0; }
  bool empty() const { return false; }
  bool full() const { return true; }
  double worstDist() const { return found_.worst(); }
  bool addPoint(double squared_distance, std::uint32_t to) {
    if (labels_[to] != labels_[from_]) found_.add({squared_distance, from_, to});
    return true;
  }

 private:
  const std::vector<std::uint32_t>& labels_;
  std::uint32_t from_;
  NearestPairs& found_;
};

/// Vertex pairs that join all components into one: each but the largest to its 3 nearest vertices of others, then the
/// same with the joined ones, until one remains. Checks at most 4,096 vertices of a component, evenly spread.
std::vector<std::pair<std::uint32_t, std::uint32_t>> find_bridges(std::span<const Vec3> positions,
                                                                  ComponentLabels labels) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> bridges;
  if (labels.count <= 1) return bridges;
  const PointSet points{positions};
  const KdTree tree(3, points);
  while (labels.count > 1) {
    std::vector<std::vector<std::uint32_t>> members(labels.count);
    for (std::uint32_t i = 0; i < labels.of_vertex.size(); ++i) members[labels.of_vertex[i]].push_back(i);
    const auto largest = std::max_element(members.begin(), members.end(),
                                          [](const auto& a, const auto& b) { return a.size() < b.size(); });
    UnionFind joined(labels.count);
    for (auto component = members.begin(); component != members.end(); ++component) {
      if (component == largest) continue;
      NearestPairs nearest(component->size() >= kPairsPerComponent);
      const std::size_t stride = (component->size() + kMaxQueries - 1) / kMaxQueries;
      for (std::size_t i = 0; i < component->size(); i += stride) {
        OtherComponentSet found(labels.of_vertex, (*component)[i], nearest);
        tree.findNeighbors(found, positions[(*component)[i]].data(), nanoflann::SearchParams());
      }
      for (const VertexPair& pair : nearest.pairs()) {
        if (!std::isfinite(pair.squared_distance)) continue;
        bridges.emplace_back(std::minmax(pair.from, pair.to));
        joined.join(labels.of_vertex[pair.from], labels.of_vertex[pair.to]);
      }
    }
    const ComponentLabels merged = labels_from(joined);
    for (std::uint32_t& label : labels.of_vertex) label = merged.of_vertex[label];
    labels.count = merged.count;
  }
  // Mutually nearest components find the same pairs.
  std::sort(bridges.begin(), bridges.end());
  bridges.erase(std::unique(bridges.begin(), bridges.end()), bridges.end());
  return bridges;
}

}  // namespace

ComponentLabels components_from_pattern(const Eigen::SparseMatrix<double>& L) {
  UnionFind sets(static_cast<std::size_t>(L.cols()));
  for (int column = 0; column < L.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(L, column); it; ++it) {
      sets.join(static_cast<std::uint32_t>(it.row()), static_cast<std::uint32_t>(it.col()));
    }
  }
  return labels_from(sets);
}

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
