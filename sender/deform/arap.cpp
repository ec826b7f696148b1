// SPDX-License-Identifier: MIT
#include "sender/deform/arap.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <Eigen/Sparse>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "common/core/worker_team.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/vector.h"

namespace eigencast::deform {
namespace {

using nlohmann::json;

Result<Vec3> point_from(const json& box, const char* name) {
  const json value = box.is_object() ? box.value(name, json()) : json();
  Vec3 p{};
  bool good = value.is_array() && value.size() == 3;
  for (std::size_t c = 0; good && c < 3; ++c) {
    good = value[c].is_number();
    if (good) p[c] = value[c].get<double>();
  }
  if (!good) return fail(ErrorCode::kCorrupt, std::string("\"") + name + "\" must be three numbers");
  return p;
}

Result<HandleGroup> group_from(const json& value, const Surface& model) {
  HandleGroup group;
  if (value.is_array()) {
    for (const json& index : value) {
      if (!index.is_number_unsigned() || index.get<std::uint64_t>() >= model.vertex_count())
        return fail(ErrorCode::kCorrupt, "must be numbers below " + std::to_string(model.vertex_count()));
      group.push_back(index.get<std::uint32_t>());
    }
  } else {
    const auto low = point_from(value, "low"), high = point_from(value, "high");
    if (!low) return low.error();
    if (!high) return high.error();
    for (std::uint32_t v = 0; v < model.vertex_count(); ++v) {
      const Vec3& p = model.positions[v];
      bool inside = true;
      for (std::size_t c = 0; c < 3; ++c) inside = inside && (*low)[c] <= p[c] && p[c] <= (*high)[c];
      if (inside) group.push_back(v);
    }
  }
  if (group.empty()) return fail(ErrorCode::kCorrupt, "holds no vertex");
  return group;
}

// Bounds the largest angle's cotangent: obtuse and degenerate triangles would repel or tear without it.
constexpr double kMinWeight = 1e-3, kMaxWeight = 1e3;

struct Neighbour {
  std::uint32_t vertex;
  double weight;
};

/// Half the sum of the cotangents across the edge, held between bounds.
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

/// The R of the greatest trace of R S, where S = sum of w_k p_k x_k^T: brings edges p_k nearest to x_k.
Eigen::Matrix3d best_rotation(const Eigen::Matrix3d& S) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(S, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d V = svd.matrixV();
  // A rotation, not a reflection: the direction that matters least is turned over.
  if ((V * svd.matrixU().transpose()).determinant() < 0) V.col(2) = -V.col(2);
  return V * svd.matrixU().transpose();
}

using Positions = Eigen::Matrix<double, Eigen::Dynamic, 3>;
using Sparse = Eigen::SparseMatrix<double>;

constexpr std::uint32_t kFree = ~0u;
constexpr std::size_t kVerticesPerTask = 256;

/// Or the number of vertices.
std::size_t unheld(const std::vector<std::vector<Neighbour>>& neighbours, const std::vector<std::uint32_t>& held) {
  std::vector<char> reached(held.size());
  std::vector<std::uint32_t> front;
  for (std::uint32_t v = 0; v < held.size(); ++v) {
    if (held[v] != kFree) reached[v] = 1, front.push_back(v);
  }
  while (!front.empty()) {
    const std::uint32_t v = front.back();
    front.pop_back();
    for (const Neighbour& n : neighbours[v]) {
      if (reached[n.vertex] == 0) reached[n.vertex] = 1, front.push_back(n.vertex);
    }
  }
  return static_cast<std::size_t>(std::find(reached.begin(), reached.end(), 0) - reached.begin());
}

Eigen::Vector3d eigen(const Vec3& p) {
  return {p[0], p[1], p[2]};
}

class ArapDeformer final : public Deformer {
 public:
  ArapDeformer(const Surface& model, std::vector<HandleGroup> groups, int iterations)
      : rest_(model.positions),
        groups_(std::move(groups)),
        iterations_(iterations),
        neighbours_(cotangent_neighbours(model.positions, model.faces)) {}

  Result<void> prepare() {
    held_.assign(rest_.size(), kFree);
    handles_ = centres_of(groups_, rest_);
    for (std::uint32_t g = 0; g < groups_.size(); ++g) {
      for (const std::uint32_t v : groups_[g]) held_[v] = g;
    }
    if (const std::size_t v = unheld(neighbours_, held_); v < rest_.size()) {
      return fail(ErrorCode::kInvalidArgument, "the part of the model with vertex " + std::to_string(v) +
                                                   " has no handle, so that nothing moves it");
    }
    unknown_.assign(rest_.size(), kFree);
    for (std::uint32_t v = 0; v < rest_.size(); ++v) {
      if (held_[v] == kFree) unknown_[v] = static_cast<std::uint32_t>(free_.size()), free_.push_back(v);
    }
    std::vector<Eigen::Triplet<double>> entries;
    for (std::uint32_t i = 0; i < free_.size(); ++i) {
      double sum = 0;
      for (const Neighbour& n : neighbours_[free_[i]]) {
        sum += n.weight;
        if (unknown_[n.vertex] < i) entries.emplace_back(i, unknown_[n.vertex], -n.weight);
      }
      entries.emplace_back(i, i, sum);
    }
    Sparse L(static_cast<Eigen::Index>(free_.size()), static_cast<Eigen::Index>(free_.size()));
    L.setFromTriplets(entries.begin(), entries.end());
    factor_.compute(L);
    if (!free_.empty() && factor_.info() != Eigen::Success)
      return fail(ErrorCode::kNumerical, "the system of the handles could not be factored");
    pose_.resize(static_cast<Eigen::Index>(rest_.size()), 3);
    for (std::size_t v = 0; v < rest_.size(); ++v)
      pose_.row(static_cast<Eigen::Index>(v)) = eigen(rest_[v]).transpose();
    rotations_.assign(rest_.size(), Eigen::Matrix3d::Identity());
    return {};
  }

  std::span<const Vec3> handles() const override { return handles_; }
  std::span<const Face> handle_faces() const override { return {}; }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override {
    assert(moved.size() == handles_.size());
    for (std::uint32_t g = 0; g < groups_.size(); ++g) {
      const Vec3 shift = moved[g] - handles_[g];
      for (const std::uint32_t v : groups_[g]) pose_.row(v) = eigen(rest_[v] + shift).transpose();
    }
    for (int i = 0; i < iterations_ && !free_.empty(); ++i) {
      fit_rotations();
      fit_positions();
    }
    std::vector<Vec3> positions(rest_.size());
    for (std::size_t v = 0; v < rest_.size(); ++v) {
      for (std::size_t c = 0; c < 3; ++c)
        positions[v][c] = pose_(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(c));
    }
    return positions;
  }

 private:
  Eigen::Vector3d row(std::uint32_t v) const { return pose_.row(v).transpose(); }
  void fit_rotations() {
    for_each_shared(rest_.size(), kVerticesPerTask, [&](std::size_t v) {
      Eigen::Matrix3d S = Eigen::Matrix3d::Zero();
      for (const Neighbour& n : neighbours_[v]) {
        S += n.weight * eigen(rest_[n.vertex] - rest_[v]) *
             (pose_.row(n.vertex) - pose_.row(static_cast<Eigen::Index>(v)));
      }
      rotations_[v] = best_rotation(S);
    });
  }

  void fit_positions() {
    Positions right(static_cast<Eigen::Index>(free_.size()), 3);
    for (std::size_t i = 0; i < free_.size(); ++i) {
      const std::uint32_t v = free_[i];
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (const Neighbour& n : neighbours_[v]) {
        sum += 0.5 * n.weight * (rotations_[v] + rotations_[n.vertex]) * eigen(rest_[v] - rest_[n.vertex]);
        if (held_[n.vertex] != kFree) sum += n.weight * row(n.vertex);
      }
      right.row(static_cast<Eigen::Index>(i)) = sum.transpose();
    }
    const Positions solved = factor_.solve(right);
    for (std::size_t i = 0; i < free_.size(); ++i) pose_.row(free_[i]) = solved.row(static_cast<Eigen::Index>(i));
  }

  std::vector<Vec3> rest_;
  std::vector<HandleGroup> groups_;
  int iterations_;
  std::vector<std::vector<Neighbour>> neighbours_;
  std::vector<Vec3> handles_;
  std::vector<std::uint32_t> held_;     ///< By vertex: its group, or kFree.
  std::vector<std::uint32_t> unknown_;  ///< By vertex: its row of the system, if free.
  std::vector<std::uint32_t> free_;     ///< Vertices by row.
  Eigen::SimplicialLDLT<Sparse> factor_;
  Positions pose_;  ///< n x 3, the last.
  std::vector<Eigen::Matrix3d> rotations_;
};

constexpr std::size_t kSamples = 150;
// Scale the energy's mean diagonal: how strongly a handle is held, and how weakly everything is held at rest.
constexpr double kHold = 1e3, kRest = 1e-7;

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Coefficients = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// Samples are spread by taking the farthest vertex again and again.
std::vector<std::uint32_t> clusters_of(std::span<const Vec3> positions, std::size_t samples) {
  std::vector<std::uint32_t> cluster(positions.size());
  std::vector<double> distance(positions.size(), std::numeric_limits<double>::infinity());
  std::size_t farthest = 0;
  for (std::uint32_t k = 0; k < samples; ++k) {
    const Vec3 sample = positions[farthest];
    for (std::size_t v = 0; v < positions.size(); ++v) {
      const Vec3 d = positions[v] - sample;
      if (dot(d, d) < distance[v]) distance[v] = dot(d, d), cluster[v] = k;
    }
    farthest = static_cast<std::size_t>(std::max_element(distance.begin(), distance.end()) - distance.begin());
  }
  return cluster;
}

class ReducedArap final : public Deformer {
 public:
  ReducedArap(const Asset& asset, int iterations) : asset_(asset), iterations_(iterations) {}

  Result<void> prepare(const std::vector<HandleGroup>& groups) {
    const std::size_t n = asset_.vertex_count, r = asset_.rank;
    std::vector<float> rest(3 * n);
    positions_from_coefficients(asset_, asset_.rest, 3, asset_.rank, asset_.vertex_count, rest);
    rest_.resize(n);
    for (std::size_t v = 0; v < n; ++v) std::copy_n(&rest[3 * v], 3, rest_[v].begin());
    C_ = Eigen::Map<const Coefficients>(asset_.rest.data(), static_cast<Eigen::Index>(r), 3);
    Eigen::MatrixXd A = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(r));
    add_energy(A);
    add_handles(groups, A);
    factor_.compute(A);
    if (factor_.info() != Eigen::Success || !factor_.isPositive())
      return fail(ErrorCode::kNumerical, "the system of the handles could not be factored");
    return {};
  }

  std::span<const Vec3> handles() const override { return handles_; }
  std::span<const Face> handle_faces() const override { return {}; }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override {
    const std::vector<double> C = coefficients(moved);
    std::vector<float> rows(3 * rest_.size());
    positions_from_coefficients(asset_, C, 3, asset_.rank, asset_.vertex_count, rows);
    std::vector<Vec3> pose(rest_.size());
    for (std::size_t v = 0; v < rest_.size(); ++v) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        pose[asset_.source_vertex[v]][axis] = static_cast<double>(rows[3 * v + axis]) + asset_.origin[axis];
    }
    return pose;
  }

  bool makes_coefficients() const override { return true; }
  std::vector<double> coefficients(std::span<const Vec3> moved) override {
    assert(moved.size() == handles_.size());
    Coefficients right = held_;
    for (std::size_t g = 0; g < moved.size(); ++g) {
      right += H_.row(static_cast<Eigen::Index>(g)).transpose() * eigen(moved[g] - handles_[g]).transpose();
    }
    Coefficients turned(G_.rows(), 3);
    for (int i = 0; i < iterations_; ++i) {
      const Coefficients S = G_ * C_;
      for (Eigen::Index k = 0; k < S.rows(); k += 3)
        turned.middleRows<3>(k) = best_rotation(S.middleRows<3>(k)).transpose();
      C_ = factor_.solve(right + G_.transpose() * turned);
    }
    return {C_.data(), C_.data() + C_.size()};
  }

 private:
  Eigen::RowVectorXf row(std::size_t v) const {
    Eigen::RowVectorXf psi(static_cast<Eigen::Index>(asset_.rank));
    asset_.copy_row(v, {psi.data(), asset_.rank});
    return psi;
  }
  void add_energy(Eigen::MatrixXd& A) {
    const std::vector<std::uint32_t> corners = triangles_at_level(asset_, asset_.vertex_count);
    std::vector<Face> faces(corners.size() / 3);
    for (std::size_t f = 0; f < faces.size(); ++f) std::copy_n(&corners[3 * f], 3, faces[f].begin());
    const auto neighbours = cotangent_neighbours(rest_, faces);
    const std::size_t samples = std::min(kSamples, rest_.size());
    const std::vector<std::uint32_t> cluster = clusters_of(rest_, samples);
    G_ = RowMatrix::Zero(static_cast<Eigen::Index>(3 * samples), A.cols());
    RowMatrix edges(64, A.cols());  // many at once, so that A is updated by whole blocks
    Eigen::Index filled = 0;
    const auto flush = [&] {
      const auto some = edges.topRows(filled);
      A.selfadjointView<Eigen::Lower>().rankUpdate(some.transpose());
      filled = 0;
    };
    for (std::size_t v = 0; v < rest_.size(); ++v) {
      for (const Neighbour& n : neighbours[v]) {
        const Eigen::RowVectorXd d = (row(v) - row(n.vertex)).cast<double>();
        const Vec3 p = rest_[v] - rest_[n.vertex];
        for (std::size_t axis = 0; axis < 3; ++axis)
          G_.row(static_cast<Eigen::Index>(3 * cluster[v] + axis)) += n.weight * p[axis] * d;
        edges.row(filled++) = std::sqrt(n.weight) * d;
        if (filled == edges.rows()) flush();
      }
    }
    if (filled > 0) flush();  // Eigen divides by the number of rows
    A.triangularView<Eigen::StrictlyUpper>() = A.transpose();
  }

  void add_handles(const std::vector<HandleGroup>& groups, Eigen::MatrixXd& A) {
    std::vector<std::uint32_t> row_of(asset_.vertex_count);
    for (std::uint32_t i = 0; i < asset_.vertex_count; ++i) row_of[asset_.source_vertex[i]] = i;
    const double scale = A.trace() / static_cast<double>(A.cols());
    H_ = RowMatrix::Zero(static_cast<Eigen::Index>(groups.size()), A.cols());
    held_ = Coefficients::Zero(A.cols(), 3);
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const double share = 1 / static_cast<double>(groups[g].size()), weight = kHold * scale * share;
      Vec3 centre{};
      for (const std::uint32_t v : groups[g]) {
        const Eigen::RowVectorXd psi = row(row_of[v]).cast<double>();
        A.noalias() += weight * psi.transpose() * psi;
        H_.row(static_cast<Eigen::Index>(g)) += weight * psi;
        held_ += weight * psi.transpose() * eigen(rest_[row_of[v]]).transpose();
        centre = centre + share * rest_[row_of[v]];
      }
      handles_.push_back(centre + asset_.origin);
    }
    A.diagonal().array() += kRest * scale;
    held_ += kRest * scale * C_;
  }

  const Asset& asset_;
  int iterations_;
  std::vector<Vec3> rest_;  ///< n, by row of the asset, in its space.
  std::vector<Vec3> handles_;
  RowMatrix G_;        ///< 3k x r: sums of w p (psi_i - psi_j) over each cluster's edges, p the edge at rest.
  RowMatrix H_;        ///< handles x r: what a shift of each handle adds to the right side.
  Coefficients held_;  ///< r x 3: the right side of handles and rest, where nothing has moved.
  Eigen::LDLT<Eigen::MatrixXd> factor_;
  Coefficients C_;  ///< The last pose.
};

}  // namespace

Result<std::vector<HandleGroup>> handle_groups_from_json(std::string_view text, const Surface& model) {
  const json root = json::parse(text, nullptr, false);
  if (!root.is_object() || !root.contains("handles") || !root["handles"].is_array())
    return fail(ErrorCode::kCorrupt, "handles: this must be {\"handles\": [...]}");
  std::vector<HandleGroup> groups;
  for (const json& value : root["handles"]) {
    auto group = group_from(value, model);
    if (!group) return in_context("handle " + std::to_string(groups.size()), group.error());
    groups.push_back(std::move(*group));
  }
  return groups;
}

Result<void> check_handles(const std::vector<HandleGroup>& groups, std::size_t vertices, std::size_t faces) {
  if (faces == 0)
    return fail(ErrorCode::kUnsupported, "handles need a mesh: a point cloud has no neighbours; use a cage");
  if (groups.empty()) return fail(ErrorCode::kInvalidArgument, "no handles are given");
  std::vector<char> taken(vertices);
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const auto wrong = [&](const std::string& what) {
      return fail(ErrorCode::kInvalidArgument, "handle " + std::to_string(g) + ": " + what);
    };
    if (groups[g].empty()) return wrong("holds no vertex");
    for (const std::uint32_t v : groups[g]) {
      if (v >= vertices) return wrong("vertex " + std::to_string(v) + " is not in the model");
      if (std::exchange(taken[v], 1) != 0) return wrong("vertex " + std::to_string(v) + " has a handle already");
    }
  }
  return {};
}

std::vector<Vec3> centres_of(const std::vector<HandleGroup>& groups, std::span<const Vec3> positions) {
  std::vector<Vec3> centres;
  for (const HandleGroup& group : groups) {
    Vec3 sum{};
    for (const std::uint32_t v : group) sum = sum + positions[v];
    centres.push_back((1.0 / static_cast<double>(group.size())) * sum);
  }
  return centres;
}

Result<std::unique_ptr<Deformer>> arap_deformer(const Surface& model, std::vector<HandleGroup> groups, int iterations) {
  assert(iterations >= 1 && iterations <= 100);
  if (const auto usable = check_handles(groups, model.vertex_count(), model.faces.size()); !usable)
    return usable.error();
  auto deformer = std::make_unique<ArapDeformer>(model, std::move(groups), iterations);
  if (const auto ready = deformer->prepare(); !ready) return ready.error();
  return std::unique_ptr<Deformer>(std::move(deformer));
}

Result<std::unique_ptr<Deformer>> reduced_arap_deformer(const Asset& asset, const std::vector<HandleGroup>& groups,
                                                        int iterations) {
  assert(asset.complete() && iterations >= 1);
  if (const auto usable = check_handles(groups, asset.vertex_count, asset.face_total); !usable) return usable.error();
  auto deformer = std::make_unique<ReducedArap>(asset, iterations);
  if (const auto ready = deformer->prepare(groups); !ready) return ready.error();
  return std::unique_ptr<Deformer>(std::move(deformer));
}

}  // namespace eigencast::deform
