// SPDX-License-Identifier: MIT
#include "sender/deform/reduced_arap.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/vector.h"
#include "sender/deform/rigidity.h"

namespace eigencast::deform {
namespace {

constexpr std::size_t kSamples = 150;
// Of the energy's mean diagonal: how strongly a handle is held, and how weakly everything is held at rest.
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

  Result<void> prepare(const std::vector<HandleGroup>& groups);
  std::span<const Vec3> handles() const override { return handles_; }
  std::span<const Face> handle_faces() const override { return {}; }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override;
  bool makes_coefficients() const override { return true; }
  std::vector<double> coefficients(std::span<const Vec3> moved) override;

 private:
  Eigen::Map<const Eigen::RowVectorXf> row(std::size_t v) const {
    return {&asset_.basis[v * asset_.rank], static_cast<Eigen::Index>(asset_.rank)};
  }
  void add_energy(Eigen::MatrixXd& A);
  void add_handles(const std::vector<HandleGroup>& groups, Eigen::MatrixXd& A);

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

Result<void> ReducedArap::prepare(const std::vector<HandleGroup>& groups) {
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

void ReducedArap::add_energy(Eigen::MatrixXd& A) {
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

void ReducedArap::add_handles(const std::vector<HandleGroup>& groups, Eigen::MatrixXd& A) {
  std::vector<std::uint32_t> row_of(asset_.vertex_count);
  for (std::uint32_t i = 0; i < asset_.vertex_count; ++i) row_of[asset_.source_vertex[i]] = i;
  const double scale = A.trace() / static_cast<double>(A.cols());
  H_ = RowMatrix::Zero(static_cast<Eigen::Index>(groups.size()), A.cols());
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const double share = 1 / static_cast<double>(groups[g].size()), weight = kHold * scale * share;
    Vec3 centre{};
    for (const std::uint32_t v : groups[g]) {
      const Eigen::RowVectorXd psi = row(row_of[v]).cast<double>();
      A.noalias() += weight * psi.transpose() * psi;
      H_.row(static_cast<Eigen::Index>(g)) += weight * psi;
      centre = centre + share * rest_[row_of[v]];
    }
    for (std::size_t axis = 0; axis < 3; ++axis) centre[axis] += asset_.origin[axis];
    handles_.push_back(centre);
  }
  // Held at rest: what handles hold, with their weights, and everything else a little.
  held_ = Coefficients::Zero(A.cols(), 3);
  for (const HandleGroup& group : groups) {
    const double weight = kHold * scale / static_cast<double>(group.size());
    for (const std::uint32_t v : group) {
      const Vec3& p = rest_[row_of[v]];
      held_ += weight * row(row_of[v]).cast<double>().transpose() * Eigen::RowVector3d(p[0], p[1], p[2]);
    }
  }
  A.diagonal().array() += kRest * scale;
  held_ += kRest * scale * C_;
}

std::vector<double> ReducedArap::coefficients(std::span<const Vec3> moved) {
  assert(moved.size() == handles_.size());
  Coefficients right = held_;
  for (std::size_t g = 0; g < moved.size(); ++g) {
    const Vec3 shift = moved[g] - handles_[g];
    right += H_.row(static_cast<Eigen::Index>(g)).transpose() * Eigen::RowVector3d(shift[0], shift[1], shift[2]);
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

std::vector<Vec3> ReducedArap::positions(std::span<const Vec3> moved) {
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

}  // namespace

Result<std::unique_ptr<Deformer>> reduced_arap_deformer(const Asset& asset, const std::vector<HandleGroup>& groups,
                                                        int iterations) {
  assert(asset.complete() && iterations >= 1);
  if (const auto usable = check_handles(groups, asset.vertex_count, asset.face_total); !usable) return usable.error();
  auto deformer = std::make_unique<ReducedArap>(asset, iterations);
  if (const auto ready = deformer->prepare(groups); !ready) return ready.error();
  return std::unique_ptr<Deformer>(std::move(deformer));
}

}  // namespace eigencast::deform
