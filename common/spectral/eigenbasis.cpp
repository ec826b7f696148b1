// SPDX-License-Identifier: MIT
#include "common/spectral/eigenbasis.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <new>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "common/spectral/bridges.h"
#include "common/spectral/lanczos.h"

namespace eigencast {
namespace {

constexpr int kDenseLimit = 512;  // below this many vertices one dense solve is faster than bands
constexpr int kBand = 32;         // eigenpairs a band aims for
constexpr double kGap = 1e-7;     // relative width from which on a gap between eigenvalues can be told from rounding
constexpr int kMaxAttempts = 60;  // at one band
constexpr double kFirstShift =
    -0.01 * 8 * std::numbers::pi;  // times 1 / area: about -1 % of the first nonzero eigenvalue

struct Cancelled : std::exception {};

/// S = M^{-1/2} L M^{-1/2}: the same eigenvalues, orthonormal eigenvectors M^{1/2} phi.
Eigen::SparseMatrix<double> symmetric_form(const Laplacian& laplacian) {
  Eigen::SparseMatrix<double> S = laplacian.L;
  const Eigen::VectorXd scale = laplacian.mass.cwiseSqrt().cwiseInverse();
  for (int column = 0; column < S.outerSize(); ++column) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(S, column); it; ++it) {
      it.valueRef() *= scale[it.row()] * scale[it.col()];
    }
  }
  return S;
}

/// The kernel of S is known without a solver: one indicator per component, M^{1/2} chi_c / sqrt(A_c).
Eigen::MatrixXd kernel_of(const Laplacian& laplacian, int most) {
  const ComponentLabels labels = components_from_pattern(laplacian.L);
  Eigen::MatrixXd kernel =
      Eigen::MatrixXd::Zero(laplacian.mass.size(), std::min<Eigen::Index>(most, Eigen::Index{labels.count}));
  for (Eigen::Index i = 0; i < laplacian.mass.size(); ++i) {
    const Eigen::Index c = labels.of_vertex[static_cast<std::size_t>(i)];
    if (c < kernel.cols()) kernel(i, c) = std::sqrt(laplacian.mass[i]);
  }
  kernel.colwise().normalize();
  return kernel;
}

/// Finds eigenpairs of S band by band upwards. All eigenvalues below `boundary_`, which lies in a gap of the spectrum,
/// are in `found_`, and the inertia of S - boundary_ I says that none is missing.
class Bands {
 public:
  Bands(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m, const Progress& progress)
      : laplacian_(laplacian), S_(S), op_(S), m_(m), progress_(progress), kernel_(kernel_of(laplacian, m)) {
    H_.resize(S.rows(), m);
    op_.on_apply([this] { tick(); });
  }

  Result<void> run() {
    append_kernel();
    while (have_ < m_) {
      if (auto done = next_band(); !done) return done;
    }
    return {};
  }

  Eigen::MatrixXd take_vectors() { return std::move(H_); }
  Eigen::VectorXd values() const { return Eigen::Map<const Eigen::VectorXd>(values_.data(), m_); }

 private:
  struct Plan {
    int nearest = 0;  // eigenpairs to ask for
    int take = 0;     // new ones expected of them
  };

  void append_kernel() {
    const auto count = std::min<Eigen::Index>(kernel_.cols(), m_);
    H_.leftCols(count) = kernel_.leftCols(count);
    values_.assign(static_cast<std::size_t>(kernel_.cols()), 0.0);
    have_ = static_cast<int>(kernel_.cols());
  }

  Result<void> next_band() {
    double step = 1;
    int extra = 0;
    for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
      applied_ = 0;
      const std::optional<Plan> plan = place_shift(step, extra);
      if (!plan) {
        step *= 0.93;
        continue;
      }
      op_.deflate(&kernel_);
      auto pairs = nearest_eigenpairs(op_, plan->nearest, 1 + static_cast<std::uint32_t>(attempt));
      if (!pairs) return pairs.error();
      if (!reaches_boundary(*pairs)) {
        step *= 0.6;
        continue;
      }
      if (complete(*pairs)) return {};
      // No gap wide enough to cut in, or one that inertia and Lanczos see differently: look at more of the spectrum.
      extra += 10;
      step *= 0.97;
    }
    return fail(ErrorCode::kNumerical,
                "the eigenvalues beyond number " + std::to_string(have_) +
                    " could not be separated: the surface's triangles differ too much in size or shape");
  }

  /// Factors at a shift above the boundary, or below zero for the first band; nothing when the factor breaks down or
  /// too many eigenvalues lie between boundary and shift.
  std::optional<Plan> place_shift(double step, int extra) {
    const int room = static_cast<int>(S_.rows() - kernel_.cols()) - 1;
    const int take = std::min(kBand, m_ - have_ + 3);
    if (first_band()) {
      if (!op_.factor(step * kFirstShift / laplacian_.area)) return std::nullopt;
      return Plan{std::min(take + 2 + extra, room), take};
    }
    if (!op_.factor(boundary_ + step * 0.42 * take * spacing_)) return std::nullopt;
    const int below = op_.eigenvalues_below() - have_;
    if (below < 0 || below > 2 * kBand / 3) return std::nullopt;
    return Plan{std::min(std::max(2 * below, take) + std::max(6, take / 6) + extra, room), take};
  }

  bool first_band() const { return have_ == static_cast<int>(kernel_.cols()); }

  /// Whether the interval that the pairs cover about the shift goes down to the boundary.
  bool reaches_boundary(const EigenPairs& pairs) const {
    if (first_band()) return true;
    return op_.sigma() - radius(pairs) < boundary_;
  }
  double radius(const EigenPairs& pairs) const { return (pairs.values.array() - op_.sigma()).abs().maxCoeff(); }

  /// Takes what lies between the old boundary and a new one in a gap; looks for the eigenpairs that inertia says are
  /// missing. False when the pairs do not fit the inertia.
  bool complete(EigenPairs& pairs) {
    const double shift = op_.sigma();
    for (std::uint32_t round = 0; round < 40; ++round) {
      const auto cut = find_cut(pairs);
      if (!cut) return false;
      if (!op_.factor(cut->at)) return false;
      const int missing = op_.eigenvalues_below() - have_ - static_cast<int>(cut->end - cut->begin);
      if (missing == 0) {
        accept(pairs, *cut);
        return true;
      }
      if (missing < 0 || !op_.factor(shift)) return false;
      if (!add_missing(pairs, std::min(missing + 1, kBand), 1000 + round)) return false;
    }
    return false;
  }

  struct Cut {
    Eigen::Index begin = 0;  // first pair above the old boundary
    Eigen::Index end = 0;    // first pair above the new one
    double at = 0;
  };

  /// The widest gap among the upper part of the new pairs, or of those that complete the basis; else the highest gap
  /// there is.
  std::optional<Cut> find_cut(const EigenPairs& pairs) const {
    const auto& lambda = pairs.values;
    const Eigen::Index count = lambda.size();
    Cut cut;
    const double floor = first_band() ? std::numeric_limits<double>::lowest() : boundary_;
    while (cut.begin < count && lambda[cut.begin] <= floor) ++cut.begin;
    const Eigen::Index fresh = count - cut.begin;
    const Eigen::Index enough = m_ - have_;
    const Eigen::Index preferred = cut.begin + (fresh > enough ? enough : fresh / 2);
    double widest = kGap * std::abs(lambda[count - 1]);
    for (Eigen::Index i = count - 1; i > cut.begin; --i) {
      if (i < preferred && cut.end > 0) break;
      const double gap = lambda[i] - lambda[i - 1];
      if (gap <= widest) continue;
      widest = gap;
      cut.end = i;
      cut.at = 0.5 * (lambda[i] + lambda[i - 1]);
    }
    if (cut.end == 0) return std::nullopt;
    return cut;
  }

  bool add_missing(EigenPairs& pairs, int count, std::uint32_t seed) {
    Eigen::MatrixXd known(S_.rows(), kernel_.cols() + pairs.vectors.cols());
    known << kernel_, pairs.vectors;
    op_.deflate(&known);
    const auto more = nearest_eigenpairs(op_, count, seed);
    op_.deflate(&kernel_);
    if (!more) return false;
    merge(pairs, *more);
    return true;
  }

  static void merge(EigenPairs& pairs, const EigenPairs& more) {
    const Eigen::Index a = pairs.values.size();
    const Eigen::Index b = more.values.size();
    EigenPairs all{Eigen::VectorXd(a + b), Eigen::MatrixXd(pairs.vectors.rows(), a + b)};
    Eigen::Index i = 0;
    Eigen::Index j = 0;
    while (i < a || j < b) {
      const bool first = j == b || (i < a && pairs.values[i] <= more.values[j]);
      all.values[i + j] = first ? pairs.values[i] : more.values[j];
      if (first) {
        all.vectors.col(i + j) = pairs.vectors.col(i);
        ++i;
      } else {
        all.vectors.col(i + j) = more.vectors.col(j);
        ++j;
      }
    }
    pairs = std::move(all);
  }

  void accept(const EigenPairs& pairs, const Cut& cut) {
    const Eigen::Index kept = std::min<Eigen::Index>(cut.end - cut.begin, m_ - have_);
    H_.middleCols(have_, kept) = pairs.vectors.middleCols(cut.begin, kept);
    for (Eigen::Index i = cut.begin; i < cut.end; ++i) values_.push_back(pairs.values[i]);
    have_ = static_cast<int>(values_.size());
    boundary_ = cut.at;
    const std::size_t window = std::min<std::size_t>(kBand, values_.size() - 1);
    spacing_ = (boundary_ - values_[values_.size() - 1 - window]) / static_cast<double>(window);
  }

  void tick() {
    ++applied_;
    if (!progress_) return;
    const double band = std::min(kBand, m_ - have_);
    const double part = std::min(0.95, applied_ / (3.0 * band + 30));
    reported_ =
        std::max(reported_, 0.95 * (have_ + band * part) / m_);  // a band that is tried again does not take it back
    if (!progress_(reported_, "eigenvectors")) throw Cancelled();
  }

  const Laplacian& laplacian_;
  const Eigen::SparseMatrix<double>& S_;
  ShiftInvert op_;
  int m_;
  const Progress& progress_;
  Eigen::MatrixXd kernel_;
  Eigen::MatrixXd H_;
  std::vector<double> values_;
  int have_ = 0;
  double boundary_ = 0;
  double spacing_ = 0;
  int applied_ = 0;
  double reported_ = 0;
};

/// Cholesky-QR: the bands are orthogonal to each other to the tolerance of Lanczos only.
bool orthonormalise(Eigen::MatrixXd& H) {
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(H.cols(), H.cols());
  gram.selfadjointView<Eigen::Lower>().rankUpdate(H.transpose());
  const Eigen::LLT<Eigen::MatrixXd> cholesky(gram);
  if (cholesky.info() != Eigen::Success) return false;
  cholesky.matrixU().solveInPlace<Eigen::OnTheRight>(H);
  return true;
}

double worst_residual(const Eigen::SparseMatrix<double>& S, const Eigen::MatrixXd& H, const Eigen::VectorXd& values) {
  double worst = 0;
  const auto positive = std::find_if(values.begin(), values.end(), [](double value) { return value > 0; });
  const double floor = positive != values.end() ? *positive : 0;
  for (Eigen::Index j = 0; j < H.cols(); ++j) {
    const double defect = (S * H.col(j) - values[j] * H.col(j)).norm();
    const double scale = std::max(values[j], floor);
    worst = std::max(worst, scale > 0 ? defect / scale : defect);
  }
  return worst;
}

Eigenbasis finish(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Eigen::MatrixXd H,
                  Eigen::VectorXd values) {
  Eigenbasis result;
  result.residual = worst_residual(S, H, values);
  result.certified = true;
  H.array().colwise() /= laplacian.mass.array().sqrt();
  result.Phi = std::move(H);
  result.eigenvalues = std::move(values);
  return result;
}

Result<Eigenbasis> solve_dense(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver{Eigen::MatrixXd(S)};
  if (solver.info() != Eigen::Success) return fail(ErrorCode::kNumerical, "the dense eigensolver did not converge");
  Eigen::MatrixXd H = solver.eigenvectors().leftCols(m);
  Eigen::VectorXd values = solver.eigenvalues().head(m);
  const Eigen::MatrixXd kernel = kernel_of(laplacian, m);
  values.head(kernel.cols()).setZero();
  H.leftCols(kernel.cols()) = kernel;
  if (!orthonormalise(H)) return fail(ErrorCode::kNumerical, "the eigenvectors of the surface are not independent");
  return finish(laplacian, S, std::move(H), std::move(values));
}

Result<Eigenbasis> solve_in_bands(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m,
                                  const Progress& progress) {
  Bands bands(laplacian, S, m, progress);
  if (auto done = bands.run(); !done) return done.error();
  Eigen::MatrixXd H = bands.take_vectors();
  if (!orthonormalise(H)) return fail(ErrorCode::kNumerical, "the eigenvectors of the surface are not independent");
  if (progress && !progress(1, "eigenvectors")) throw Cancelled();
  return finish(laplacian, S, std::move(H), bands.values());
}

}  // namespace

Result<Eigenbasis> solve_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress) {
  const Eigen::Index n = laplacian.mass.size();
  if (m < 1 || 2 * Eigen::Index{m} >= n) {
    return fail(ErrorCode::kInvalidArgument, "a surface of " + std::to_string(n) + " vertices has no " +
                                                 std::to_string(m) +
                                                 " smooth harmonics: ask for fewer than half its vertices");
  }
  try {
    const Eigen::SparseMatrix<double> S = symmetric_form(laplacian);
    if (progress && !progress(0, "eigenvectors")) throw Cancelled();
    if (n <= kDenseLimit) return solve_dense(laplacian, S, m);
    return solve_in_bands(laplacian, S, m, progress);
  } catch (const Cancelled&) {
    return fail(ErrorCode::kCancelled, "stopped while solving for eigenvectors");
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for " + std::to_string(m) + " eigenvectors of " +
                                          std::to_string(n) + " vertices: ask for fewer, or simplify the surface");
  } catch (const std::exception& error) {
    return fail(ErrorCode::kNumerical, std::string("the eigensolver stopped: ") + error.what());
  }
}

}  // namespace eigencast
