// SPDX-License-Identifier: MIT
#include "common/spectral/augment.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "common/core/worker_team.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/multilevel.h"

namespace eigencast {
namespace {

constexpr double kFlat = 1e-13;               // relative residual below which a coordinate is dependent
constexpr double kDependent = 1e-2;           // relative residual below which a column is noise
constexpr double kFlatProduct = 1e-9;         // norm of a product with a coordinate that does not vary
constexpr double kDependentOnCoarser = 2e-2;  // the same on a coarser surface, which adds noise
constexpr int kHarmonicsPerTurn = 7;          // between two groups of three products
constexpr Eigen::Index kCoarseEnough = 3000;  // vertices that suffice to count the harmonics needed

/// x0, y0, z0 (n x 3) about the M-centroid, in units of their root mean square.
Eigen::MatrixXd centred_rest(std::span<const Vec3> positions, const Eigen::VectorXd& mass) {
  Eigen::MatrixXd rest = matrix_from_positions(positions);
  const Eigen::RowVector3d centroid = mass.transpose() * rest / mass.sum();
  rest.rowwise() -= centroid;
  const double size = std::sqrt((mass.asDiagonal() * rest.cwiseAbs2()).sum() / mass.sum());
  return size > 0 ? Eigen::MatrixXd(rest / size) : rest;
}

/// M^{1/2} times 1, x0, y0, z0, orthonormalised in this order: n x (1..4), without dependent coordinates.
Eigen::MatrixXd orthonormal_affine(const Eigen::VectorXd& root_mass, const Eigen::MatrixXd& rest) {
  Eigen::MatrixXd columns(root_mass.size(), 4);
  columns.col(0) = root_mass.normalized();
  Eigen::Index count = 1;
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd column = root_mass.cwiseProduct(rest.col(axis));
    for (int pass = 0; pass < 3; ++pass) {
      const auto before = columns.leftCols(count);
      column -= before * (before.transpose() * column);
      if (pass == 0 && column.norm() < kFlat * root_mass.norm()) column.setZero();
      column.normalize();  // leaves zero as it is
    }
    if (column.norm() < 0.5) continue;
    columns.col(count++) = column;
  }
  return columns.leftCols(count);
}

/// Chooses columns in order by a Cholesky factorisation of their Gram matrix; skips dependent ones.
class Selection {
 public:
  Selection(const Eigen::MatrixXd& gram, int rank) : gram_(gram), R_(Eigen::MatrixXd::Zero(rank, rank)) {}

  const std::vector<Eigen::Index>& chosen() const { return chosen_; }

  /// Takes candidate `index` if at least `threshold` of its norm is new.
  void offer(Eigen::Index index, double threshold) {
    const double squared_norm = gram_(index, index);
    const auto k = static_cast<Eigen::Index>(chosen_.size());
    if (k == R_.cols() || !(squared_norm > 0)) return;
    Eigen::VectorXd column(k);
    for (Eigen::Index i = 0; i < k; ++i) column[i] = gram_(chosen_[static_cast<std::size_t>(i)], index);
    R_.topLeftCorner(k, k).triangularView<Eigen::Upper>().transpose().solveInPlace(column);
    const double rest = squared_norm - column.squaredNorm();
    if (!(rest > threshold * threshold * squared_norm)) return;
    R_.col(k).head(k) = column;
    R_(k, k) = std::sqrt(rest);
    chosen_.push_back(index);
  }

  /// Upper triangular: chosen columns = Q R.
  Eigen::MatrixXd R() const {
    const auto k = static_cast<Eigen::Index>(chosen_.size());
    return R_.topLeftCorner(k, k);
  }

 private:
  const Eigen::MatrixXd& gram_;
  Eigen::MatrixXd R_;
  std::vector<Eigen::Index> chosen_;
};

/// affine | harmonics but the constant | phi_k * (x0, y0, z0) for k = 2..K, normalised.
struct CandidateColumns {
  Panels panels;
  Eigen::Index affine = 0, harmonics = 0;
};

/// A column: scale * values * times, elementwise; null `times` is 1.
struct Column {
  const double* values = nullptr;
  const double* times = nullptr;
  double scale = 1;
};

void fill(std::span<const Column> columns, Panels& panels) {
  for_panels(panels.count(), [&](Eigen::Index panel) {
    const std::size_t first = static_cast<std::size_t>(panel) * kPanelWidth;
    const std::size_t count = std::min(kPanelWidth, columns.size() - first);
    double* to = panels[panel];
    for (Eigen::Index i = 0; i < panels.rows(); ++i, to += kPanelWidth) {
      for (std::size_t j = 0; j < count; ++j) {
        const Column& column = columns[first + j];
        to[j] = column.scale * column.values[i] * (column.times != nullptr ? column.times[i] : 1);
      }
    }
  });
}

CandidateColumns candidate_columns(const Candidates& from, int K) {
  const Eigen::Index a = from.affine.cols();
  const Eigen::Index m = from.harmonics.cols() - 1;
  std::vector<Column> columns;
  for (Eigen::Index j = 0; j < a; ++j) columns.push_back({from.affine.col(j).data()});
  for (Eigen::Index j = 0; j < m; ++j) columns.push_back({from.harmonics.col(j + 1).data()});
  for (Eigen::Index k = 1; k < K; ++k) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      columns.push_back({from.harmonics.col(k).data(), from.rest.col(axis).data()});
    }
  }
  worker_team().run(columns.size() - static_cast<std::size_t>(a + m), [&](std::size_t i) {
    const auto product = static_cast<Eigen::Index>(i);
    const double norm = from.harmonics.col(1 + product / 3).cwiseProduct(from.rest.col(product % 3)).norm();
    columns[static_cast<std::size_t>(a + m) + i].scale = norm > kFlatProduct ? 1 / norm : 0;
  });
  CandidateColumns result{zero_panels(from.harmonics.rows(), static_cast<Eigen::Index>(columns.size())), a, m};
  fill(columns, result.panels);
  return result;
}

struct Selected {
  Selection selection;
  Eigen::Index harmonics_offered = 0;  // the constant not counted
};

Selected select(const Eigen::MatrixXd& gram, Eigen::Index affine, Eigen::Index harmonics, int K, int rank,
                double dependent) {
  Selection selection(gram, rank);
  for (Eigen::Index i = 0; i < affine; ++i) selection.offer(i, 0);
  Eigen::Index next = 0;
  const auto offer_harmonics = [&](std::size_t until) {
    while (next < harmonics && selection.chosen().size() < until) selection.offer(affine + next++, dependent);
  };
  for (Eigen::Index k = 1; k < K; ++k) {
    offer_harmonics(selection.chosen().size() + kHarmonicsPerTurn);
    const std::size_t after = selection.chosen().size() + 3;
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      selection.offer(affine + harmonics + 3 * (k - 1) + axis, dependent);
    }
    offer_harmonics(after);
  }
  offer_harmonics(static_cast<std::size_t>(rank));
  return {std::move(selection), next};
}

/// Positions of a coarser surface's vertices.
std::vector<Vec3> averages(const Coarsened& coarse, const Eigen::VectorXd& mass, std::span<const Vec3> positions) {
  const Eigen::MatrixXd moments = coarse.P.transpose() * (mass.asDiagonal() * matrix_from_positions(positions));
  const Eigen::VectorXd weights = coarse.P.transpose() * mass;
  std::vector<Vec3> means(static_cast<std::size_t>(weights.size()));
  Eigen::Map<Eigen::Array<double, Eigen::Dynamic, 3, Eigen::RowMajor>>(means.front().data(), weights.size(), 3) =
      moments.array().colwise() / weights.array();
  return means;
}

}  // namespace

PositionMap matrix_from_positions(std::span<const Vec3> positions) {
  static_assert(sizeof(Vec3) == 3 * sizeof(double));
  return {positions.empty() ? nullptr : positions.front().data(), static_cast<Eigen::Index>(positions.size()), 3};
}

Candidates candidates_from(std::span<const Vec3> rest, const Eigen::VectorXd& mass) {
  Candidates candidates;
  candidates.rest = centred_rest(rest, mass);
  candidates.affine = orthonormal_affine(mass.cwiseSqrt(), candidates.rest);
  return candidates;
}

Augmentation::Augmentation(Candidates& from, int K) : panels_(0) {
  CandidateColumns columns = candidate_columns(from, K);
  from.harmonics.resize(0, 0);
  affine_ = columns.affine;
  harmonics_ = columns.harmonics;
  panels_ = std::move(columns.panels);
  gram_ = gram(panels_);
}

Eigen::Index Augmentation::columns(int k, int rank) const {
  return static_cast<Eigen::Index>(select(gram_, affine_, harmonics_, k, rank, kDependent).selection.chosen().size());
}

Eigen::MatrixXd Augmentation::rows(int k, int rank, std::span<const std::uint32_t> vertices) const {
  const Selection selection = select(gram_, affine_, harmonics_, k, rank, kDependent).selection;
  Eigen::MatrixXd rows(static_cast<Eigen::Index>(vertices.size()),
                       static_cast<Eigen::Index>(selection.chosen().size()));
  for (Eigen::Index j = 0; j < rows.cols(); ++j) {
    for (Eigen::Index i = 0; i < rows.rows(); ++i)
      rows(i, j) = panels_.at(vertices[static_cast<std::size_t>(i)], selection.chosen()[static_cast<std::size_t>(j)]);
  }
  const Eigen::MatrixXd R = selection.R();
  R.triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(rows);
  return rows;
}

Eigen::MatrixXd Augmentation::take(int k, int rank) {
  const Selection selection = select(gram_, affine_, harmonics_, k, rank, kDependent).selection;
  const auto chosen = static_cast<Eigen::Index>(selection.chosen().size());
  Panels Q = zero_panels(panels_.rows(), chosen);
  for_panels(Q.count(), [&](Eigen::Index panel) {
    for (Eigen::Index j = panel * kWidth; j < std::min(chosen, (panel + 1) * kWidth); ++j) {
      copy_column(panels_, selection.chosen()[static_cast<std::size_t>(j)], Q, j);
    }
  });
  panels_.drop_from(0);
  Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(Q.columns(), Q.columns());
  turn.topLeftCorner(chosen, chosen) =
      selection.R().triangularView<Eigen::Upper>().solve(Eigen::MatrixXd::Identity(chosen, chosen));
  rotate(Q, turn);
  orthonormalise(Q, chosen);  // once more: the Gram matrix squares the condition number
  return matrix_from(Q, chosen);
}

int harmonics_on_coarser(std::span<const Vec3> rest, const Laplacian& laplacian, int K, int rank) {
  Laplacian coarse;
  std::vector<Vec3> positions(rest.begin(), rest.end());
  const Laplacian* here = &laplacian;
  const Eigen::Index least = 4 * Eigen::Index{rank};
  while (here->mass.size() > std::max(kCoarseEnough, 2 * least)) {
    Coarsened next = coarsen(*here);
    if (next.laplacian.mass.size() < least || 10 * next.laplacian.mass.size() > 9 * here->mass.size()) break;
    positions = averages(next, here->mass, positions);
    coarse = std::move(next.laplacian);
    here = &coarse;
  }
  if (here == &laplacian) return 0;
  auto eigenbasis = solve_eigenbasis_exactly(coarse, rank);
  if (!eigenbasis) return 0;
  Candidates candidates = candidates_from(positions, coarse.mass);
  candidates.harmonics = std::move(eigenbasis->Phi);
  candidates.harmonics.array().colwise() *= coarse.mass.cwiseSqrt().array();
  const CandidateColumns columns = candidate_columns(candidates, K);
  const Eigen::MatrixXd products = gram(columns.panels);
  return 1 + static_cast<int>(
                 select(products, columns.affine, columns.harmonics, K, rank, kDependentOnCoarser).harmonics_offered);
}

}  // namespace eigencast
