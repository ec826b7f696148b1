// SPDX-License-Identifier: MIT
#include "common/spectral/multilevel.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cassert>
#include <cmath>
#include <memory>
#include <string_view>
#include <vector>

#include "common/core/worker_team.h"
#include "common/spectral/multigrid.h"
#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr Eigen::Index kWidth = kPanelWidth;
constexpr double kCoarseShare = 0.15;  // of the time, for progress
constexpr double kFactorBytes = 700;   // of a row, at some hundred thousand
constexpr double kGridBytes = 300;     // of a row: operators, transfers, the factor of a coarser level
constexpr int kLikelySteps = 2;
constexpr int kSweeps = 2;  // of preconditioned iteration between two projections

/// Vectors that are iterated for m wanted: more make it converge faster.
Eigen::Index columns_for(int m) {
  return (m + std::max(m / 5, 16) + kWidth - 1) / kWidth * kWidth;
}

/// The prolongated panels of a coarser level.
Panels descend(const Hierarchy& hierarchy, std::size_t to_level, const Panels& from) {
  Panels to = zero_panels(hierarchy.rows(to_level), from.columns());
  worker_team().run(static_cast<std::size_t>(from.count()), [&](std::size_t panel) {
    const auto j = static_cast<Eigen::Index>(panel);
    prolongate(hierarchy.Q(to_level), from[j], to[j]);
  });
  return to;
}

/// Rayleigh-Ritz: turns H so that A = H^T S H and B = H^T H become diagonal, the latter ones. Returns the Ritz values.
Result<Eigen::VectorXd> turn_to_ritz(Panels& H, const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  const Eigen::VectorXd scale = B.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled_A = scale.asDiagonal() * A * scale.asDiagonal();
  const Eigen::MatrixXd scaled_B = scale.asDiagonal() * B * scale.asDiagonal();
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> solver(scaled_A, scaled_B);
  if (solver.info() != Eigen::Success || !solver.eigenvalues().allFinite()) {
    return fail(ErrorCode::kNumerical, "the approximate eigenvectors of the surface are not independent");
  }
  rotate(H, scale.asDiagonal() * solver.eigenvectors());
  return solver.eigenvalues();
}

/// Calls work(panel, its number in the batch) for all panels of H, a batch of as many as there are threads at a time, then
/// after(first, count) for each batch. Errors: kCancelled.
template <class GoOn, class Work, class After>
Result<void> for_batches(const Panels& H, const GoOn& go_on, const Work& work, const After& after) {
  const auto batch = static_cast<Eigen::Index>(worker_team().threads());
  for (Eigen::Index first = 0; first < H.count(); first += batch) {
    const Eigen::Index count = std::min(batch, H.count() - first);
    worker_team().run(static_cast<std::size_t>(count),
                      [&](std::size_t k) { work(first + static_cast<Eigen::Index>(k), k); });
    after(first, count);
    if (!go_on(0.8 * static_cast<double>(first + count) / static_cast<double>(H.count()))) {
      return fail(ErrorCode::kCancelled, "stopped while solving for eigenvectors");
    }
  }
  return {};
}

/// A step of block inverse iteration. With Y = (S - sigma I)^{-1} H the projected operator is Y^T S Y = Y^T H + sigma Y^T Y, so
/// S itself is never applied; and since H^T Y is symmetric, panels of H may be overwritten by those of Y as soon as the rows
/// of H^T Y that they are in are known. `go_on` is told the share of the step that is done. Returns the Ritz values. Errors:
/// kCancelled, kNumerical.
template <class GoOn>
Result<Eigen::VectorXd> step_by_factor(const ShiftInvert& inverse, Panels& H, const GoOn& go_on) {
  const Eigen::Index p = H.columns();
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(p, p);  // H^T Y, its lower triangle
  const std::size_t threads = worker_team().threads();
  Panels Y = zero_panels(H.rows(), static_cast<Eigen::Index>(threads) * kWidth);
  std::vector<std::vector<double>> scratch(threads, std::vector<double>(static_cast<std::size_t>(H.rows() * kWidth)));
  const auto done = for_batches(
      H, go_on,
      [&](Eigen::Index panel, std::size_t k) {
        double* y = Y[static_cast<Eigen::Index>(k)];
        std::copy_n(H[panel], H.rows() * kWidth, y);
        inverse.apply_in_place(y, scratch[k].data());
      },
      [&](Eigen::Index first, Eigen::Index count) {
        for (Eigen::Index b = 0; b < count; ++b) {
          G.block(first * kWidth, (first + b) * kWidth, p - first * kWidth, kWidth) =
              transposed_product(H, first, H.count(), Y[b]);
        }
        for (Eigen::Index b = 0; b < count; ++b) std::copy_n(Y[b], H.rows() * kWidth, H[first + b]);
      });
  if (!done) return done.error();
  Y.drop_from(0);
  scratch.clear();
  const Eigen::MatrixXd B = gram(H);
  const Eigen::MatrixXd cross = G.selfadjointView<Eigen::Lower>();
  return turn_to_ritz(H, cross + inverse.sigma() * B, B);
}

/// The same by steps of preconditioned inverse iteration on each vector by itself, `values` their Ritz values, or near them.
template <class GoOn>
Result<Eigen::VectorXd> step_by_grid(const Hierarchy& hierarchy, const Multigrid& grid, std::size_t level, Panels& H,
                                     const Eigen::VectorXd& values, const GoOn& go_on) {
  const Eigen::Index p = H.columns();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(p, p);  // H^T S H, its upper triangle
  const std::size_t threads = worker_team().threads();
  Panels Y = zero_panels(H.rows(), static_cast<Eigen::Index>(threads) * kWidth);
  std::vector<Multigrid::Scratch> scratch;
  for (std::size_t k = 0; k < threads; ++k) scratch.push_back(grid.scratch());
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(kWidth);
  const auto done = for_batches(
      H, go_on,
      [&](Eigen::Index panel, std::size_t k) {
        for (int sweep = 0; sweep < kSweeps; ++sweep) {
          grid.improve(level, H[panel], values.data() + panel * kWidth, scratch[k]);
        }
        panel_functions().multiply(rows_of(hierarchy.S(level)), 0, static_cast<std::size_t>(H.rows()), H[panel],
                                   none.data(), Y[static_cast<Eigen::Index>(k)]);
      },
      [&](Eigen::Index first, Eigen::Index count) {
        for (Eigen::Index b = 0; b < count; ++b) {
          A.block(0, (first + b) * kWidth, (first + count) * kWidth, kWidth) =
              transposed_product(H, 0, first + count, Y[b]);
        }
      });
  if (!done) return done.error();
  Y.drop_from(0);
  scratch.clear();
  return turn_to_ritz(H, A.selfadjointView<Eigen::Upper>(), gram(H));
}

/// Eigenvalues below the m-th Ritz value beyond m - 1 of them: Ritz values lie above what they approximate, so a count that fits
/// says that none was passed over.
int count_missed(ShiftInvert& inverse, const Eigen::VectorXd& values, int m) {
  const double at = values.size() > m ? 0.5 * (values[m - 1] + values[m]) : values[m - 1] * (1 + 1e-6);
  for (const double shift : {at, at * (1 + 1e-7), at * (1 - 1e-7)}) {
    if (inverse.factor(shift)) return std::max(0, inverse.eigenvalues_below() - m);
  }
  return m;  // not known: the worst
}

Panels panels_from(const Eigenbasis& basis, const Laplacian& laplacian) {
  Panels H = zero_panels(basis.Phi.rows(), basis.Phi.cols());
  const Eigen::VectorXd root = laplacian.mass.cwiseSqrt();
  for (Eigen::Index j = 0; j < basis.Phi.cols(); ++j) {
    for (Eigen::Index i = 0; i < H.rows(); ++i) H.at(i, j) = root[i] * basis.Phi(i, j);
  }
  return H;
}

/// The first m of the Ritz vectors, the kernel as it is known.
Result<Eigenbasis> finish(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Eigen::VectorXd values,
                          int m, Panels H) {
  values.conservativeResize(m);
  const Kernel kernel = kernel_of(laplacian, m);
  for (int c = 0; c < kernel.count; ++c) copy_column(kernel.vectors, c, H, c);
  values.head(kernel.count).setZero();
  H.drop_from((m + kWidth - 1) / kWidth);
  for (Eigen::Index i = 0; i < H.rows(); ++i) {
    for (Eigen::Index j = m; j < H.columns(); ++j) H.at(i, j) = 0;
  }
  if (!orthonormalise(H, m)) {
    return fail(ErrorCode::kNumerical, "the approximate eigenvectors of the surface are not independent");
  }
  Eigenbasis result = eigenbasis_from(laplacian, S, std::move(H), std::move(values));
  result.certified = false;
  result.approximate = true;
  return result;
}

}  // namespace

double multilevel_bytes(Eigen::Index n, int m) {
  const bool by_grid = n > MultilevelOptions{}.factored_vertices;
  const double panels = (by_grid ? 5.0 : 2.0) * worker_team().threads();
  const double columns = static_cast<double>(columns_for(m)) + m + panels * kWidth;
  return static_cast<double>(n) * (8 * columns + (by_grid ? kGridBytes : kFactorBytes));
}

Result<Eigenbasis> approximate_eigenbasis(const Laplacian& laplacian, int m, const MultilevelOptions& options,
                                          const Progress& progress) {
  constexpr std::string_view kStage = "eigenvectors, approximately";
  const Eigen::Index p = columns_for(m);
  const Hierarchy hierarchy(laplacian, std::max(options.coarse_vertices, 4 * p), 2 * p + 1);
  if (hierarchy.depth() == 0) return solve_eigenbasis_exactly(laplacian, m, progress);
  const Progress coarsest = [&](double fraction, std::string_view) {
    return !progress || progress(kCoarseShare * fraction, kStage);
  };
  auto coarse = solve_eigenbasis_exactly(hierarchy.laplacian(hierarchy.depth()), static_cast<int>(p), coarsest);
  if (!coarse) return coarse.error();
  Panels H = panels_from(*coarse, hierarchy.laplacian(hierarchy.depth()));
  Eigen::VectorXd values = std::move(coarse->eigenvalues);
  coarse->Phi.resize(0, 0);

  auto grid = Multigrid::create(hierarchy, options.factored_vertices);
  if (!grid) return grid.error();
  double done = kCoarseShare;
  std::optional<int> missed;
  for (std::size_t level = hierarchy.depth(); level-- > 0;) {
    H = descend(hierarchy, level, H);
    const double share =
        0.8 * static_cast<double>(hierarchy.rows(level)) / (kLikelySteps * static_cast<double>(laplacian.L.rows()));
    const auto go_on = [&](double part) { return !progress || progress(std::min(0.97, done + share * part), kStage); };
    std::unique_ptr<ShiftInvert> inverse;
    if (level >= (*grid)->factored_level()) {
      inverse = std::make_unique<ShiftInvert>(hierarchy.S(level));
      if (!inverse->factor(first_shift(hierarchy.laplacian(level).area))) return cannot_be_factored();
    }
    double before = 0;
    for (int step = 0; step < (level == 0 ? options.most_steps : 1); ++step) {
      auto next =
          inverse ? step_by_factor(*inverse, H, go_on) : step_by_grid(hierarchy, **grid, level, H, values, go_on);
      if (!next) return next.error();
      values = std::move(*next);
      done += share;
      const double sum = values.head(m).sum();
      if (std::abs(before - sum) <= options.change * sum) break;
      before = sum;
    }
    if (level == 0 && inverse) missed = count_missed(*inverse, values, m);
  }
  auto result = finish(laplacian, hierarchy.S(0), std::move(values), m, std::move(H));
  if (result) result->missed = missed;
  return result;
}

}  // namespace eigencast
