// SPDX-License-Identifier: MIT
#include "common/spectral/basis.h"

#include <algorithm>
#include <cassert>
#include <string>
#include <vector>

#include "common/spectral/augment.h"
#include "common/spectral/multilevel.h"

namespace eigencast {
namespace {

/// Groups of products phi_k * (x0, y0, z0), without a trial and at most: ten are best on large smooth surfaces
/// (elephant, human), twenty on small rough ones (horse, fox).
constexpr int kGroups = 10, kMaxGroups = 20;
constexpr Eigen::Index kWorthPredicting = 20000;  // vertices
constexpr double kSolveShare = 0.85;              // of the time, for progress

Basis basis_from(const Laplacian& laplacian, const Eigenbasis& eigenbasis, Eigen::MatrixXd Psi) {
  Basis basis;
  basis.Psi = std::move(Psi);
  basis.mass = laplacian.mass;
  basis.area = laplacian.area;
  basis.residual = eigenbasis.residual;
  basis.certified = eigenbasis.certified;
  basis.approximate = eigenbasis.approximate;
  basis.missed = eigenbasis.missed;
  return basis;
}

/// Errors: those of the trial.
Result<BasisShape> try_groups(const Augmentation& augmentation, int K, int max_K, int rank, const BasisTrial& trial,
                              const Eigen::VectorXd& root_mass) {
  std::vector<OfferedBasis> offers;
  for (const int k : {K, max_K}) {
    if (!offers.empty() && k == K) continue;
    OfferedBasis& offer = offers.emplace_back(OfferedBasis{k, augmentation.rows(k, rank, trial.vertices)});
    offer.rows.array().colwise() /= root_mass(trial.vertices).array();
  }
  return trial.choose(offers);
}

Result<Basis> build_augmented(const Surface& rest, const Laplacian& laplacian, int rank, const BasisOptions& options,
                              const Progress& progress, const BasisTrial* trial) {
  const int K = std::clamp(rank / 10, 1, kGroups), max_K = trial ? std::clamp(rank / 10, K, kMaxGroups) : K;
  const Eigen::VectorXd root_mass = laplacian.mass.cwiseSqrt();
  Candidates candidates = candidates_from(rest.positions, laplacian.mass);

  // Dependent products make room for more harmonics; how many is known only afterwards. Where a second solve would take
  // long, a coarser surface predicts the number.
  const int limit = rank - static_cast<int>(candidates.affine.cols()) + 4;
  int m = std::clamp(rank - 3 * K + 3, K, limit);
  if (options.provisional) {
    m = limit;  // They cost next to nothing.
  } else if (laplacian.mass.size() > kWorthPredicting) {
    m = std::max(m, std::min(limit, harmonics_on_coarser(rest.positions, laplacian, K, rank)));
  }
  double done = 0;
  for (;;) {
    m = std::min<int>(m, static_cast<int>((laplacian.mass.size() - 1) / 2));
    const double share = (1 - done) * kSolveShare;
    const Progress part = [&](double fraction, std::string_view stage) {
      return !progress || progress(done + share * fraction, stage);
    };
    auto eigenbasis = options.provisional ? provisional_eigenbasis(laplacian, m, part)
                                          : solve_eigenbasis(laplacian, m, part, options.solver);
    if (!eigenbasis) return eigenbasis.error();
    done += share;
    candidates.harmonics = std::move(eigenbasis->Phi);
    candidates.harmonics.array().colwise() *= root_mass.array();
    if (progress && !progress(done, "augmenting")) {
      return fail(ErrorCode::kCancelled, "stopped while augmenting the basis");
    }
    Augmentation augmentation(candidates, std::min(max_K, m));
    BasisShape shape{rank, std::min(K, m)};
    const auto columns = static_cast<int>(augmentation.columns(shape.products, rank));
    if (columns < rank && m < limit && 2 * (m + 1) < laplacian.mass.size()) {
      m = std::min(limit, m + std::max<int>(rank - columns, rank / 8));
      continue;
    }
    if (trial != nullptr) {
      const auto chosen = try_groups(augmentation, shape.products, std::min(max_K, m), rank, *trial, root_mass);
      if (!chosen) return chosen.error();
      shape = *chosen;
    }
    Eigen::MatrixXd Q = augmentation.take(shape.products, shape.rank);
    Q.array().colwise() /= root_mass.array();
    return basis_from(laplacian, *eigenbasis, std::move(Q));
  }
}

}  // namespace

Result<BasisKind> basis_from_name(std::string_view name) {
  if (const auto kind = kBasisNames.find(name)) return *kind;
  std::string known;
  for (const std::string_view other : kBasisNames.names) known += (known.empty() ? "" : ", ") + std::string(other);
  return fail(ErrorCode::kInvalidArgument, "there is no basis '" + std::string(name) + "'; known: " + known);
}

Result<void> cut_by_trial(Basis& basis, const BasisTrial& trial) {
  const OfferedBasis whole{0, basis.Psi(trial.vertices, Eigen::all)};
  const auto chosen = trial.choose({&whole, 1});
  if (!chosen) return chosen.error();
  basis.Psi.conservativeResize(Eigen::NoChange, chosen->rank);
  if (basis.rms.size() > 0) basis.rms.conservativeResize(chosen->rank);
  return {};
}

Result<Basis> build_basis(const Surface& rest, const Laplacian& laplacian, const BasisOptions& options,
                          const Progress& progress, const BasisTrial* trial) {
  assert(options.kind == BasisKind::kAugmented || options.kind == BasisKind::kHarmonic);
  const Eigen::Index n = laplacian.mass.size();
  if (static_cast<Eigen::Index>(rest.vertex_count()) != n) {
    return fail(ErrorCode::kInvalidArgument, "the Laplacian of " + std::to_string(n) +
                                                 " vertices does not belong to this surface of " +
                                                 std::to_string(rest.vertex_count()));
  }
  if (options.rank < 1) {
    return fail(ErrorCode::kInvalidArgument,
                "a basis of " + std::to_string(options.rank) + " columns: ask for at least 1");
  }
  // Any augmented basis needs four columns for its rest pose.
  const Eigen::Index least = options.kind == BasisKind::kAugmented ? std::min<Eigen::Index>(4, n) : 1;
  const int rank = static_cast<int>(std::min<Eigen::Index>(options.rank, std::max<Eigen::Index>(least, n / 2 - 1)));
  try {
    if (options.kind == BasisKind::kAugmented) {
      return build_augmented(rest, laplacian, rank, options, progress, trial);
    }
    auto eigenbasis = solve_eigenbasis(laplacian, rank, progress, options.solver);
    if (!eigenbasis) return eigenbasis.error();
    Basis basis = basis_from(laplacian, *eigenbasis, std::move(eigenbasis->Phi));
    if (trial != nullptr) {
      if (const auto cut = cut_by_trial(basis, *trial); !cut) return cut.error();
    }
    return basis;
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

}  // namespace eigencast
