// SPDX-License-Identifier: MIT
#include "common/spectral/basis.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "common/spectral/affine.h"
#include "common/spectral/panels.h"

namespace eigencast {
namespace {

constexpr double kDependent = 1e-2;    // relative residual below which a column says nothing new but noise
constexpr double kFlatProduct = 1e-9;  // norm of a product with a coordinate that does not vary
constexpr int kHarmonicsPerTurn = 7;   // between two groups of three products
constexpr double kSolveShare = 0.85;   // of the time, for progress

/// Everything here is in the symmetric form h = M^{1/2} psi, where the inner product is the plain one.
struct Candidates {
  Eigen::MatrixXd affine;     // n x (1..4): the constant and what x0, y0, z0 add to it, orthonormal
  Eigen::MatrixXd harmonics;  // n x m, orthonormal, the constant first
  Eigen::MatrixXd rest;  // n x 3: x0, y0, z0 about the M-centroid in units of their root mean square; not times M^{1/2}
};

/// Chooses columns in embedded order by a Cholesky factorisation of their Gram matrix that grows by one column at a
/// time and passes over columns that those before determine.
class Selection {
 public:
  Selection(Eigen::MatrixXd gram, int rank) : gram_(std::move(gram)), R_(Eigen::MatrixXd::Zero(rank, rank)) {}

  bool full() const { return static_cast<Eigen::Index>(chosen_.size()) == R_.cols(); }
  const std::vector<Eigen::Index>& chosen() const { return chosen_; }

  /// Takes candidate `index` if at least `threshold` of its norm is new.
  void offer(Eigen::Index index, double threshold) {
    const double squared_norm = gram_(index, index);
    if (full() || !(squared_norm > 0)) return;
    const Eigen::Index k = static_cast<Eigen::Index>(chosen_.size());
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
  Eigen::MatrixXd gram_;
  Eigen::MatrixXd R_;
  std::vector<Eigen::Index> chosen_;
};

/// All candidate columns side by side: affine | harmonics but the constant | phi_k * (x0, y0, z0) for k = 2..K,
/// normalised.
struct CandidateColumns {
  Panels panels;
  Eigen::Index affine = 0, harmonics = 0;
};

CandidateColumns candidate_columns(const Candidates& from, int K) {
  const Eigen::Index n = from.harmonics.rows();
  const Eigen::Index a = from.affine.cols();
  const Eigen::Index m = from.harmonics.cols() - 1;
  CandidateColumns columns{zero_panels(n, a + m + 3 * (K - 1)), a, m};
  const auto set = [&](Eigen::Index j, const auto& column) {
    for (Eigen::Index i = 0; i < n; ++i) columns.panels.at(i, j) = column[i];
  };
  for (Eigen::Index j = 0; j < a; ++j) set(j, from.affine.col(j));
  for (Eigen::Index j = 0; j < m; ++j) set(a + j, from.harmonics.col(j + 1));
  for (Eigen::Index k = 1; k < K; ++k) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      Eigen::VectorXd column = from.harmonics.col(k).cwiseProduct(from.rest.col(axis));
      const double norm = column.norm();
      column *= norm > kFlatProduct ? 1 / norm : 0;
      set(a + m + 3 * (k - 1) + axis, column);
    }
  }
  return columns;
}

Selection select(const CandidateColumns& columns, int K, int rank) {
  const Eigen::Index affine = columns.affine, harmonics = columns.harmonics;
  Selection selection(gram(columns.panels), rank);
  for (Eigen::Index i = 0; i < affine; ++i) selection.offer(i, 0);
  Eigen::Index next = 0;
  const auto offer_harmonics = [&](std::size_t until) {
    while (next < harmonics && selection.chosen().size() < until) selection.offer(affine + next++, kDependent);
  };
  for (Eigen::Index k = 1; k < K; ++k) {
    offer_harmonics(selection.chosen().size() + kHarmonicsPerTurn);
    const std::size_t after = selection.chosen().size() + 3;
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      selection.offer(affine + harmonics + 3 * (k - 1) + axis, kDependent);
    }
    offer_harmonics(after);
  }
  offer_harmonics(std::numeric_limits<std::size_t>::max());
  return selection;
}

/// The columns of an augmented basis of `rank`, orthonormal; fewer when the harmonics do not suffice to fill up.
Eigen::MatrixXd augment(const Candidates& from, int K, int rank) {
  CandidateColumns columns = candidate_columns(from, K);
  const Selection selection = select(columns, K, rank);
  const auto chosen = static_cast<Eigen::Index>(selection.chosen().size());
  Panels Q = zero_panels(from.harmonics.rows(), chosen);
  for (Eigen::Index j = 0; j < chosen; ++j) {
    copy_column(columns.panels, selection.chosen()[static_cast<std::size_t>(j)], Q, j);
  }
  columns.panels.drop_from(0);
  Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(Q.columns(), Q.columns());
  turn.topLeftCorner(chosen, chosen) =
      selection.R().triangularView<Eigen::Upper>().solve(Eigen::MatrixXd::Identity(chosen, chosen));
  rotate(Q, turn);
  orthonormalise(Q, chosen);  // once more: the Gram matrix squares the condition number
  Eigen::MatrixXd result(Q.rows(), chosen);
  for (Eigen::Index j = 0; j < chosen; ++j) {
    for (Eigen::Index i = 0; i < Q.rows(); ++i) result(i, j) = Q.at(i, j);
  }
  return result;
}

Basis basis_from(BasisKind kind, const Laplacian& laplacian, const Eigenbasis& eigenbasis, Eigen::MatrixXd Psi) {
  Basis basis;
  basis.kind = kind;
  basis.Psi = std::move(Psi);
  basis.mass = laplacian.mass;
  basis.area = laplacian.area;
  basis.residual = eigenbasis.residual;
  basis.certified = eigenbasis.certified;
  basis.approximate = eigenbasis.approximate;
  basis.missed = eigenbasis.missed;
  return basis;
}

Result<Basis> build_harmonic(const Laplacian& laplacian, int rank, const Progress& progress) {
  auto eigenbasis = solve_eigenbasis(laplacian, rank, progress);
  if (!eigenbasis) return eigenbasis.error();
  Eigen::MatrixXd Phi = std::move(eigenbasis->Phi);
  return basis_from(BasisKind::kHarmonic, laplacian, *eigenbasis, std::move(Phi));
}

Result<Basis> build_augmented(const Surface& rest, const Laplacian& laplacian, int rank, const Progress& progress) {
  const int K = std::max(1, rank / 10);
  const Eigen::VectorXd root_mass = laplacian.mass.cwiseSqrt();
  Candidates candidates;
  candidates.rest = centred_rest(rest.positions, laplacian.mass);
  candidates.affine = orthonormal_affine(root_mass, candidates.rest);

  // Products that depend on others leave room for more harmonics: how many more is known only once they are there.
  const int most = rank - static_cast<int>(candidates.affine.cols()) + 4;
  int m = std::clamp(rank - 3 * K + 3, K, most);
  double done = 0;
  for (;;) {
    m = std::min<int>(m, static_cast<int>((laplacian.mass.size() - 1) / 2));
    const double share = (1 - done) * kSolveShare;
    const Progress part = [&](double fraction, std::string_view stage) {
      return !progress || progress(done + share * fraction, stage);
    };
    auto eigenbasis = solve_eigenbasis(laplacian, m, part);
    if (!eigenbasis) return eigenbasis.error();
    done += share;
    candidates.harmonics = std::move(eigenbasis->Phi);
    candidates.harmonics.array().colwise() *= root_mass.array();
    if (progress && !progress(done, "augmenting")) {
      return fail(ErrorCode::kCancelled, "stopped while augmenting the basis");
    }
    Eigen::MatrixXd Q = augment(candidates, std::min(K, m), rank);
    if (Q.cols() < rank && m < most && 2 * (m + 1) < laplacian.mass.size()) {
      m = std::min(most, m + std::max<int>(rank - static_cast<int>(Q.cols()), rank / 8));
      continue;
    }
    Q.array().colwise() /= root_mass.array();
    return basis_from(BasisKind::kAugmented, laplacian, *eigenbasis, std::move(Q));
  }
}

}  // namespace

Result<Basis> build_basis(const Surface& rest, const Laplacian& laplacian, const BasisOptions& options,
                          const Progress& progress) {
  assert(options.kind == BasisKind::kAugmented || options.kind == BasisKind::kHarmonic);
  const Eigen::Index n = laplacian.mass.size();
  if (static_cast<Eigen::Index>(rest.vertex_count()) != n) {
    return fail(ErrorCode::kInvalidArgument, "the Laplacian of " + std::to_string(n) +
                                                 " vertices is not of this surface of " +
                                                 std::to_string(rest.vertex_count()));
  }
  if (options.rank < 1) {
    return fail(ErrorCode::kInvalidArgument,
                "a basis of " + std::to_string(options.rank) + " columns: ask for at least 1");
  }
  // Four columns hold the rest pose of any augmented basis, however few the vertices.
  const Eigen::Index least = options.kind == BasisKind::kAugmented ? std::min<Eigen::Index>(4, n) : 1;
  const int rank = static_cast<int>(std::min<Eigen::Index>(options.rank, std::max<Eigen::Index>(least, n / 2 - 1)));
  try {
    if (options.kind == BasisKind::kHarmonic) return build_harmonic(laplacian, rank, progress);
    return build_augmented(rest, laplacian, rank, progress);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for a basis of " + std::to_string(n) + " x " +
                                          std::to_string(rank) + ": lower the rank, or simplify the surface");
  }
}

Eigen::MatrixXd coefficients_from_positions(const Basis& basis, std::span<const Vec3> positions) {
  assert(static_cast<Eigen::Index>(positions.size()) == basis.Psi.rows());
  const Eigen::Matrix<double, Eigen::Dynamic, 3> weighted = basis.mass.asDiagonal() * matrix_from_positions(positions);
  return basis.Psi.transpose() * weighted;
}

std::vector<Vec3> positions_from_coefficients(const Basis& basis, const Eigen::MatrixXd& C) {
  assert(C.rows() == basis.Psi.cols() && C.cols() == 3);
  std::vector<Vec3> positions(static_cast<std::size_t>(basis.Psi.rows()));
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>(positions.front().data(), basis.Psi.rows(), 3) =
      basis.Psi * C;
  return positions;
}

void KgError::add_frame(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  assert(truth.size() == rebuilt.size());
  if (truth.empty()) return;
  const auto X = matrix_from_positions(truth);
  const Eigen::RowVector3d mean = X.colwise().mean();
  numerator_ += (X - matrix_from_positions(rebuilt)).squaredNorm();
  denominator_ += (X.rowwise() - mean).squaredNorm();
}

double KgError::percent() const {
  if (denominator_ > 0) return 100 * std::sqrt(numerator_ / denominator_);
  return numerator_ > 0 ? std::numeric_limits<double>::infinity() : 0;
}

}  // namespace eigencast
