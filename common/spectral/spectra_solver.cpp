// SPDX-License-Identifier: MIT
#include <Spectra/SymEigsSolver.h>

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kPrecision = 1e-11;  // of 1 / (lambda - sigma)
constexpr double kSeparate = 1e-6;    // relative gap between eigenvalues that inertia can count in
constexpr Index kBeyond = 8;          // pairs sought beyond m, so that there is a gap to count in
constexpr Index kMaxSpectraRounds = 40;
constexpr Index kSpectraRestarts = 300;

using Factor = Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>;

/// Columns of the Krylov space for `count` pairs.
Index krylov_columns(Index count, Index room) {
  return std::min(room, 2 * count + 20);
}

/// The operator that Spectra iterates: (S - sigma I)^-1 in the complement of the known eigenvectors.
class ComplementSolve {
 public:
  using Scalar = double;  // as Spectra asks
  ComplementSolve(const Factor& factor, const MatrixXd& known, std::function<void()> on_apply)
      : factor_(factor), known_(known), on_apply_(std::move(on_apply)) {}
  Index rows() const { return known_.rows(); }
  Index cols() const { return known_.rows(); }
  VectorXd projected(VectorXd x) const {
    for (int pass = 0; pass < 2; ++pass) x -= known_ * (known_.transpose() * x);
    return x;
  }
  void perform_op(const double* x, double* y) const {
    Eigen::Map<VectorXd>(y, rows()) = projected(factor_.solve(projected(Eigen::Map<const VectorXd>(x, rows()))));
    on_apply_();
  }

 private:
  const Factor& factor_;
  const MatrixXd& known_;
  std::function<void()> on_apply_;
};

class SpectraSolver {
 public:
  SpectraSolver(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m, const Progress& progress)
      : laplacian_(laplacian), S_(S), m_(m), sigma_(first_shift(laplacian.area)), progress_(progress) {
    const Kernel kernel = kernel_of(laplacian, std::numeric_limits<int>::max());
    vectors_ = matrix_from(kernel.vectors, kernel.count);
    values_ = VectorXd::Zero(kernel.count);
  }

  Result<Eigenbasis> run() {
    if (values_.size() >= m_) return finish();
    factor_.analyzePattern(S_);
    factor_.setShift(-sigma_);
    factor_.factorize(S_);
    counter_.analyzePattern(S_);
    if (factor_.info() != Eigen::Success) return failed("has no factor");
    Index wanted = std::min(Index{m_} + kBeyond, S_.rows() - 1);
    for (Index round = 0; round < kMaxSpectraRounds; ++round) {
      if (values_.size() < wanted) {
        if (auto more = find(wanted - values_.size()); !more) return more.error();
      }
      const Index gap = gap_from(m_);
      if (gap == values_.size()) {
        wanted = values_.size() + kBeyond;
        continue;
      }
      const Index missing = count_below(0.5 * (values_[gap - 1] + values_[gap])) - gap;
      if (missing == 0) return finish();
      if (missing < 0) return failed("has fewer eigenvalues than were found");
      wanted = values_.size() + missing + 1;
    }
    return failed("has eigenvalues that could not be separated");
  }

 private:
  Result<Eigenbasis> finish() const {
    if (progress_ && !progress_(1, "eigenvectors")) throw Cancelled();
    return eigenbasis_from(laplacian_, S_, panels_from(vectors_.leftCols(m_)), values_.head(m_),
                           "Spectra: the eigenvectors");
  }

  static Error failed(const std::string& what) {
    return fail(ErrorCode::kNumerical, "Spectra: the surface's operator " + what + "; use the solver 'lanczos'");
  }

  /// The `count` lowest pairs in the complement of those found.
  Result<void> find(Index count) {
    const Index room = S_.rows() - values_.size();
    count = std::min(count, room - 1);
    const Index columns = krylov_columns(count, room);
    ComplementSolve op(factor_, vectors_, [this, columns] { tick(columns); });
    Spectra::SymEigsSolver<ComplementSolve> solver(op, count, columns);
    solver.init();
    solver.compute(Spectra::SortRule::LargestAlge, kSpectraRestarts, kPrecision);
    if (solver.info() != Spectra::CompInfo::Successful) return failed("did not converge");
    merge(solver.eigenvalues().cwiseInverse().array() + sigma_, solver.eigenvectors());
    return {};
  }

  void merge(const VectorXd& values, const MatrixXd& vectors) {
    const Index before = values_.size(), after = before + values.size();
    values_.conservativeResize(after);
    values_.tail(values.size()) = values;
    vectors_.conservativeResize(Eigen::NoChange, after);
    vectors_.rightCols(values.size()) = vectors;
    std::vector<Index> order(static_cast<std::size_t>(after));
    std::iota(order.begin(), order.end(), Index{0});
    std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) { return values_[a] < values_[b]; });
    vectors_ = vectors_(Eigen::all, order).eval();
    values_ = values_(order).eval();
  }

  /// The first pair from `first` on that is apart from the one before it; values_.size(): none is.
  Index gap_from(Index first) const {
    for (; first < values_.size(); ++first) {
      if (values_[first] - values_[first - 1] > kSeparate * std::abs(values_[first])) break;
    }
    return std::min(first, values_.size());
  }

  Index count_below(double value) {
    counter_.setShift(-value);
    counter_.factorize(S_);
    return (counter_.vectorD().array() < 0).count();
  }

  void tick(Index expected) {
    ++applied_;
    const double done = static_cast<double>(applied_) / static_cast<double>(applied_ + expected);
    if (progress_ && !progress_(0.95 * done, "eigenvectors by Spectra")) throw Cancelled();
  }

  const Laplacian& laplacian_;
  const Eigen::SparseMatrix<double>& S_;
  int m_;
  double sigma_;
  const Progress& progress_;
  Factor factor_, counter_;
  VectorXd values_;   // ascending, the kernel's first
  MatrixXd vectors_;  // n x values_.size()
  Index applied_ = 0;
};

}  // namespace

double spectra_bytes(Eigen::Index n, int m) {
  const auto columns = static_cast<double>(krylov_columns(m + kBeyond, n) + 4 * (m + kBeyond));
  return 8 * static_cast<double>(n) * columns;
}

Result<Eigenbasis> spectra_eigenbasis(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m,
                                      const Progress& progress) {
  return SpectraSolver(laplacian, S, m, progress).run();
}

}  // namespace eigencast
