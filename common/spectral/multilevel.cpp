// SPDX-License-Identifier: MIT
#include "common/spectral/multilevel.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <string_view>
#include <utility>
#include <vector>

#include "common/core/worker_team.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/shift_invert.h"
#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr double kCoarseShare = 0.15;  // of the time, for progress
constexpr double kFactorBytes = 1000;  // per row, at a million rows
constexpr int kLikelySteps = 2;
constexpr double kDamping = 0.66;  // of Jacobi's step, in units of 1 / diagonal
constexpr int kFree = -1;
// Of a provisional basis: the most vertices that are solved exactly, and steps of smoothing after each interpolation.
constexpr Eigen::Index kProvisionalVertices = 30000;
constexpr int kSmoothings = 3;

using RowMatrix = Eigen::SparseMatrix<double, Eigen::RowMajor>;
using Entry = Eigen::SparseMatrix<double>::InnerIterator;

struct Aggregates {
  std::vector<int> of;
  int count = 0;
};

Aggregates aggregate(const Eigen::SparseMatrix<double>& L) {
  const int n = static_cast<int>(L.cols());
  Aggregates result{std::vector<int>(static_cast<std::size_t>(n), kFree), 0};
  const auto of = [&](Eigen::Index i) -> int& { return result.of[static_cast<std::size_t>(i)]; };
  for (int i = 0; i < n; ++i) {
    bool all_free = of(i) == kFree;
    for (Entry it(L, i); it && all_free; ++it) all_free = of(it.row()) == kFree;
    if (!all_free) continue;
    for (Entry it(L, i); it; ++it) of(it.row()) = result.count;
    of(i) = result.count++;
  }
  // A free vertex joins the aggregate of its strongest neighbour; it has a neighbour in one, or it would be one itself.
  const std::vector<int> before = result.of;
  for (int i = 0; i < n; ++i) {
    if (of(i) != kFree) continue;
    double strongest = 0;
    for (Entry it(L, i); it; ++it) {
      const int other = before[static_cast<std::size_t>(it.row())];
      if (other == kFree || (of(i) != kFree && -it.value() <= strongest)) continue;
      strongest = -it.value();
      of(i) = other;
    }
    if (of(i) == kFree) of(i) = result.count++;
  }
  return result;
}

/// Vectors iterated for m wanted ones; more converge faster.
Eigen::Index columns_for(int m) {
  return whole_panels(m + std::max(m / 5, 16));
}

Panels prolongate(const Coarsened& coarse, const Eigen::VectorXd& fine_mass, const Panels& from) {
  Panels to = zero_panels(coarse.P.rows(), from.columns());
  const Eigen::VectorXd unscale = coarse.laplacian.mass.cwiseSqrt().cwiseInverse();
  const Eigen::VectorXd scale = fine_mass.cwiseSqrt();
  for_panels(from.count(), [&](Eigen::Index j) {
    for (Eigen::Index i = 0; i < coarse.P.outerSize(); ++i) {
      double* row = to[j] + i * kWidth;
      for (decltype(coarse.P)::InnerIterator it(coarse.P, i); it; ++it) {
        const double* other = from[j] + it.col() * kWidth;
        const double weight = scale[i] * it.value() * unscale[it.col()];
        for (Eigen::Index k = 0; k < kWidth; ++k) row[k] += weight * other[k];
      }
    }
  });
  return to;
}

/// Block inverse iteration on one level. With Y = (S - sigma I)^{-1} H, Y^T S Y = Y^T H + sigma Y^T Y: S is never
/// applied. H^T Y is symmetric, so panels of Y overwrite those of H once their rows of it are known.
class InverseIteration {
 public:
  InverseIteration(const Laplacian& laplacian, Panels& H) : H_(H), S_(symmetric_form(laplacian)), op_(S_) {
    scratch_.resize(worker_team().threads(), std::vector<double>(static_cast<std::size_t>(H.rows() * kWidth)));
  }

  Result<void> factor(double sigma) {
    if (op_.factor(sigma)) return {};
    return fail(ErrorCode::kNumerical,
                "the surface's operator cannot be factored: its triangles differ too much in size or shape");
  }

  /// Calls `go_on` with the finished share of the step from time to time. Errors: kCancelled, kNumerical.
  template <class GoOn>
  Result<void> step(const GoOn& go_on) {
    const Eigen::Index p = H_.columns();
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(p, p);  // H^T Y, its lower triangle
    const auto batch = static_cast<Eigen::Index>(scratch_.size());
    Panels Y = zero_panels(H_.rows(), batch * kWidth);
    for (Eigen::Index first = 0; first < H_.count(); first += batch) {
      const Eigen::Index count = std::min(batch, H_.count() - first);
      for_panels(count,
                 [&](Eigen::Index b) { op_.apply(H_[first + b], Y[b], scratch_[static_cast<std::size_t>(b)].data()); });
      for (Eigen::Index b = 0; b < count; ++b) {
        G.block(first * kWidth, (first + b) * kWidth, p - first * kWidth, kWidth) =
            transposed_product(H_, first, H_.count(), Y[b]);
      }
      for (Eigen::Index b = 0; b < count; ++b) std::copy_n(Y[b], H_.rows() * kWidth, H_[first + b]);
      if (!go_on(0.8 * static_cast<double>(first + count) / static_cast<double>(H_.count()))) {
        return fail(ErrorCode::kCancelled, "stopped while solving for eigenvectors");
      }
    }
    Y.drop_from(0);
    return project(G);
  }

  const Eigen::VectorXd& values() const { return values_; }
  const Eigen::SparseMatrix<double>& S() const { return S_; }
  ShiftInvert& op() { return op_; }

 private:
  Result<void> project(const Eigen::MatrixXd& G) {
    const Eigen::MatrixXd B = gram(H_);
    const Eigen::VectorXd scale = B.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd cross = G.selfadjointView<Eigen::Lower>();
    const Eigen::MatrixXd A = scale.asDiagonal() * (cross + op_.sigma() * B) * scale.asDiagonal();
    const Eigen::MatrixXd scaled = scale.asDiagonal() * B * scale.asDiagonal();
    DenseEigen pairs = dense_eigen(A, scaled);
    if (!pairs.converged || !pairs.values.allFinite()) {
      return fail(ErrorCode::kNumerical, "the approximate eigenvectors of the surface are not independent");
    }
    values_ = std::move(pairs.values);
    rotate(H_, scale.asDiagonal() * pairs.vectors);
    return {};
  }

  Panels& H_;
  Eigen::SparseMatrix<double> S_;
  ShiftInvert op_;
  std::vector<std::vector<double>> scratch_;  // a panel for each thread
  Eigen::VectorXd values_;
};

/// Eigenvalues below the m-th Ritz value beyond the m expected ones. Ritz values lie above the eigenvalues that they
/// approximate, so a matching count means that none is missing.
int count_missed(InverseIteration& iteration, int m) {
  const auto& values = iteration.values();
  const double at = values.size() > m ? 0.5 * (values[m - 1] + values[m]) : values[m - 1] * (1 + 1e-6);
  for (const double shift : {at, at * (1 + 1e-7), at * (1 - 1e-7)}) {
    if (iteration.op().factor(shift)) return std::max(0, iteration.op().eigenvalues_below() - m);
  }
  return m;  // unknown: assume the worst
}

/// A surface's operator, at level 0, and coarser ones.
class Hierarchy {
 public:
  Hierarchy(const Laplacian& finest, Eigen::Index enough, Eigen::Index least) : finest_(finest) {
    while (at(depth()).L.rows() > enough) {
      Coarsened coarse = coarsen(at(depth()));
      const Eigen::Index now = coarse.laplacian.L.rows();
      if (now < least || 10 * now > 9 * at(depth()).L.rows()) break;
      coarser_.push_back(std::make_unique<Coarsened>(std::move(coarse)));
    }
  }

  std::size_t depth() const { return coarser_.size(); }
  const Laplacian& at(std::size_t level) const { return level == 0 ? finest_ : coarser_[level - 1]->laplacian; }
  /// Interpolates vectors of the coarsest level to the next finer one, which becomes the coarsest.
  Panels descend(const Panels& from) {
    Panels to = prolongate(*coarser_.back(), at(depth() - 1).mass, from);
    coarser_.pop_back();
    return to;
  }

 private:
  const Laplacian& finest_;
  std::vector<std::unique_ptr<Coarsened>> coarser_;
};

Result<Eigenbasis> finish(const Laplacian& laplacian, const InverseIteration& iteration, int m, int missed, Panels H) {
  Eigen::VectorXd values = iteration.values().head(m);
  const Kernel kernel = kernel_of(laplacian, m);
  for (int c = 0; c < kernel.count; ++c) copy_column(kernel.vectors, c, H, c);
  values.head(kernel.count).setZero();
  H.drop_from(whole_panels(m) / kWidth);
  for (Eigen::Index i = 0; i < H.rows(); ++i) {
    for (Eigen::Index j = m; j < H.columns(); ++j) H.at(i, j) = 0;
  }
  auto result = eigenbasis_from(laplacian, iteration.S(), std::move(H), std::move(values),
                                "the approximate eigenvectors of the surface");
  if (!result) return result;
  result->certified = false;
  result->approximate = true;
  result->missed = missed;
  return result;
}

}  // namespace

Coarsened coarsen(const Laplacian& fine) {
  const Aggregates aggregates = aggregate(fine.L);
  const Eigen::Index n = fine.L.rows();
  RowMatrix indicators(n, aggregates.count);
  indicators.reserve(Eigen::VectorXi::Ones(n));
  Coarsened coarse;
  coarse.laplacian.mass = Eigen::VectorXd::Zero(aggregates.count);
  for (Eigen::Index i = 0; i < n; ++i) {
    const int a = aggregates.of[static_cast<std::size_t>(i)];
    indicators.insert(i, a) = 1;
    coarse.laplacian.mass[a] += fine.mass[i];
  }
  const Eigen::VectorXd step = fine.L.diagonal().unaryExpr([](double d) { return d > 0 ? kDamping / d : 0.0; });
  const RowMatrix L = fine.L;
  coarse.P = indicators - RowMatrix(step.asDiagonal() * RowMatrix(L * indicators));
  const RowMatrix LP = L * coarse.P;
  coarse.laplacian.L = RowMatrix(RowMatrix(coarse.P.transpose()) * LP);
  coarse.laplacian.area = fine.area;
  coarse.laplacian.components = fine.components;
  coarse.laplacian.bridges = fine.bridges;
  return coarse;
}

double multilevel_bytes(Eigen::Index n, int m) {
  const auto threads = static_cast<double>(worker_team().threads());
  const double columns = static_cast<double>(columns_for(m)) + m + 2 * threads * kWidth;
  return static_cast<double>(n) * (8 * columns + kFactorBytes);
}

Result<Eigenbasis> provisional_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress) {
  std::deque<Coarsened> levels;
  const auto at = [&](std::size_t level) -> const Laplacian& {
    return level == 0 ? laplacian : levels[level - 1].laplacian;
  };
  while (at(levels.size()).L.rows() > kProvisionalVertices) {
    Coarsened coarse = coarsen(at(levels.size()));
    if (coarse.laplacian.L.rows() <= 2 * m) break;
    levels.push_back(std::move(coarse));
  }
  auto basis = solve_eigenbasis_exactly(at(levels.size()), m, progress);
  if (!basis || levels.empty()) return basis;
  for (std::size_t level = levels.size(); level-- > 0;) {
    const Laplacian& here = at(level);
    const RowMatrix L = here.L;
    const Eigen::VectorXd step = here.L.diagonal().unaryExpr([](double d) { return d > 0 ? kDamping / d : 0.0; });
    basis->Phi = levels[level].P * basis->Phi;
    for (int i = 0; i < kSmoothings; ++i) basis->Phi -= step.asDiagonal() * (L * basis->Phi).eval();
  }
  const Eigen::MatrixXd A = basis->Phi.transpose() * (RowMatrix(laplacian.L) * basis->Phi);
  const Eigen::MatrixXd B = basis->Phi.transpose() * laplacian.mass.asDiagonal() * basis->Phi;
  DenseEigen pairs = dense_eigen(A, B);
  if (!pairs.converged || !pairs.values.allFinite())
    return fail(ErrorCode::kNumerical, "the interpolated eigenvectors of the surface are not independent");
  basis->Phi *= pairs.vectors;
  basis->eigenvalues = std::move(pairs.values);
  basis->certified = false;
  basis->approximate = true;
  return basis;
}

Result<Eigenbasis> approximate_eigenbasis(const Laplacian& laplacian, int m, const MultilevelOptions& options,
                                          const Progress& progress) {
  constexpr std::string_view kStage = "eigenvectors, approximately";
  const Eigen::Index p = columns_for(m);
  Hierarchy hierarchy(laplacian, std::max(options.coarse_vertices, 4 * p), 2 * p + 1);
  if (hierarchy.depth() == 0) return solve_eigenbasis_exactly(laplacian, m, progress);
  const Progress coarsest = [&](double fraction, std::string_view) {
    return !progress || progress(kCoarseShare * fraction, kStage);
  };
  auto coarse = solve_eigenbasis_exactly(hierarchy.at(hierarchy.depth()), static_cast<int>(p), coarsest);
  if (!coarse) return coarse.error();
  coarse->Phi.array().colwise() *= hierarchy.at(hierarchy.depth()).mass.cwiseSqrt().array();
  Panels H = panels_from(coarse->Phi);
  coarse->Phi.resize(0, 0);

  double done = kCoarseShare;
  while (true) {
    H = hierarchy.descend(H);
    const bool finest = hierarchy.depth() == 0;
    const Laplacian& here = hierarchy.at(hierarchy.depth());
    const double share =
        0.8 * static_cast<double>(here.L.rows()) / (kLikelySteps * static_cast<double>(laplacian.L.rows()));
    const auto go_on = [&](double part) { return !progress || progress(std::min(0.97, done + share * part), kStage); };
    InverseIteration iteration(here, H);
    if (auto made = iteration.factor(first_shift(here.area)); !made) return made.error();
    double before = 0;
    for (int step = 0; step < (finest ? options.max_steps : 1); ++step) {
      if (auto made = iteration.step(go_on); !made) return made.error();
      done += share;
      const double sum = iteration.values().head(m).sum();
      if (std::abs(before - sum) <= options.change * sum) break;
      before = sum;
    }
    if (!finest) continue;
    return finish(laplacian, iteration, m, count_missed(iteration, m), std::move(H));
  }
}

}  // namespace eigencast
