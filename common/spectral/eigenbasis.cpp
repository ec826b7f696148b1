// SPDX-License-Identifier: MIT
#include "common/spectral/eigenbasis.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <new>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "common/core/machine.h"
#include "common/spectral/block_lanczos.h"
#include "common/spectral/multilevel.h"
#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

constexpr int kDenseLimit = 512;   // below this many vertices one dense solve is faster than bands
constexpr int kLargestBand = 256;  // eigenpairs a band aims for: more cost too much to keep apart
constexpr int kSmallestBand = 32;
constexpr double kGap = 1e-7;   // relative width of the narrowest gap between eigenvalues that is not rounding
constexpr double kSame = 1e-9;  // relative width of a cluster that counts as one eigenvalue
constexpr int kMaxAttempts = 60;  // at one band

/// Peak bytes of solving for m pairs, without the factor: the subspace of the largest band, and the pairs.
double bytes_needed(Eigen::Index n, int m) {
  const int columns = expected_subspace(std::min(m, kLargestBand) + 8) * 5 / 4 + m;
  return static_cast<double>(n) * columns * static_cast<double>(sizeof(double));
}

std::string stage_text(double bytes) {
  if (bytes < 1e9) return "eigenvectors";
  const std::string tenths = std::to_string(std::lround(bytes * 1e-8));
  return "eigenvectors (about " + tenths.substr(0, tenths.size() - 1) + "." + tenths.back() + " GB of memory)";
}

/// Finds eigenpairs of S band by band upwards. `boundary_` lies in a gap of the spectrum; all eigenvalues below it are
/// in `values_`, by the inertia of S - boundary_ I.
class Bands {
 public:
  Bands(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m, const Progress& progress)
      : laplacian_(laplacian),
        S_(S),
        op_(S),
        m_(m),
        band_(std::clamp(static_cast<int>(S.rows() / 8), kSmallestBand, kLargestBand)),
        progress_(progress),
        stage_(stage_text(bytes_needed(S.rows(), m))),
        kernel_(kernel_of(laplacian, m)),
        H_(zero_panels(S.rows(), m)),
        values_(static_cast<std::size_t>(kernel_.count), 0.0),
        have_(kernel_.count),
        marks_(S.rows()) {
    for (int c = 0; c < kernel_.count; ++c) copy_column(kernel_.vectors, c, H_, c);
    std::mt19937 random(3);
    for (double& mark : marks_) mark = static_cast<double>(random()) / 4294967296.0;
    op_.on_apply([this] { tick(); });
  }

  Result<Eigenbasis> run() {
    while (have_ < m_) {
      if (auto done = next_band(); !done) return done.error();
    }
    if (progress_ && !progress_(1, "eigenvectors")) throw Cancelled();
    return eigenbasis_from(laplacian_, S_, std::move(H_), Eigen::Map<const Eigen::VectorXd>(values_.data(), m_));
  }

 private:
  struct Plan {
    int nearest = 0;  // eigenpairs to ask for
    int take = 0;     // new ones expected of them
  };

  Result<void> next_band() {
    double step = 1;
    int extra = 0;
    for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
      applied_ = 0;
      const std::optional<Plan> plan = choose_shift(step, extra);
      if (!plan) {
        step *= 0.93;
        continue;
      }
      expected_ = expected_subspace(plan->nearest) / static_cast<int>(kPanelWidth);
      auto pairs = nearest_eigenpairs(op_, plan->nearest, 1 + static_cast<std::uint32_t>(attempt), {&kernel_.vectors});
      if (!pairs) return pairs.error();
      if (!reaches_boundary(*pairs)) {
        step *= 0.6;
        continue;
      }
      if (complete(*pairs)) return {};
      // No wide gap, or inertia and Lanczos disagree there: take in more of the spectrum.
      extra += 10;
      step *= 0.97;
    }
    return fail(ErrorCode::kNumerical,
                "the eigenvalues beyond number " + std::to_string(have_) +
                    " could not be separated: the surface's triangles differ too much in size or shape");
  }

  /// Factors at a shift above the boundary (first band: below zero). Nothing where the factor breaks down, or where too
  /// many eigenvalues lie between boundary and shift.
  std::optional<Plan> choose_shift(double step, int extra) {
    const int room = static_cast<int>(S_.rows() - kernel_.count) - 1;
    const int take = std::min(band_, m_ - have_ + 3);
    if (first_band()) {
      if (!op_.factor(step * first_shift(laplacian_.area))) return std::nullopt;
      return Plan{std::min(take + 2 + extra, room), take};
    }
    if (!op_.factor(boundary_ + step * 0.42 * take * spacing_)) return std::nullopt;
    const int below = op_.eigenvalues_below() - have_;
    if (below < 0 || below > 2 * band_ / 3) return std::nullopt;
    return Plan{std::min(std::max(2 * below, take) + std::max(6, take / 6) + extra, room), take};
  }

  bool first_band() const { return have_ == kernel_.count; }

  /// Whether the interval that the pairs cover about the shift goes down to the boundary.
  bool reaches_boundary(const EigenPairs& pairs) const {
    const double radius = (pairs.values.array() - op_.sigma()).abs().maxCoeff();
    return first_band() || op_.sigma() - radius < boundary_;
  }

  /// Accepts the pairs between the old boundary and a new one in a gap, and solves for those that inertia counts as
  /// missing. False where pairs and inertia contradict each other.
  bool complete(EigenPairs& pairs) {
    const double shift = op_.sigma();
    for (std::uint32_t round = 0; round < 40; ++round) {
      const auto cut = find_cut(pairs);
      if (!cut || !op_.factor(cut->at)) return false;
      const int missing = op_.eigenvalues_below() - have_ - static_cast<int>(cut->end - cut->begin);
      if (missing == 0) {
        accept(pairs, *cut);
        return true;
      }
      if (missing < 0 || !op_.factor(shift)) return false;
      const auto more =
          nearest_eigenpairs(op_, std::min(missing + 1, band_), 1000 + round, {&kernel_.vectors, &pairs.vectors});
      if (!more) return false;
      merge(pairs, *more);
    }
    return false;
  }

  struct Cut {
    Eigen::Index begin = 0;  // first pair above the old boundary
    Eigen::Index end = 0;    // first pair above the new one
    double at = 0;
  };

  /// The widest gap in the upper part of the new pairs, or beyond those that complete the basis; else the highest gap.
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

  static void merge(EigenPairs& pairs, const EigenPairs& more) {
    const Eigen::Index a = pairs.values.size(), b = more.values.size();
    EigenPairs all{Eigen::VectorXd(a + b), zero_panels(pairs.vectors.rows(), a + b)};
    for (Eigen::Index i = 0, j = 0; i < a || j < b;) {
      const bool first = j == b || (i < a && pairs.values[i] <= more.values[j]);
      all.values[i + j] = first ? pairs.values[i] : more.values[j];
      copy_column(first ? pairs.vectors : more.vectors, first ? i : j, all.vectors, i + j);
      ++(first ? i : j);
    }
    pairs = std::move(all);
  }

  /// Rounding decides which vectors span an eigenspace of several dimensions. Replaces them by those that diagonalise a
  /// fixed function on the vertices, so that the same surface gives the same basis at every scale.
  void choose_in_clusters(EigenPairs& pairs, const Cut& cut) const {
    const auto& lambda = pairs.values;
    for (Eigen::Index first = cut.begin, end = first; first < cut.end; first = end) {
      for (++end; end < cut.end && lambda[end] - lambda[end - 1] <= kSame * std::abs(lambda[end]);) ++end;
      if (end - first < 2) continue;
      Eigen::MatrixXd X(S_.rows(), end - first);
      for (Eigen::Index i = 0; i < X.rows(); ++i) {
        for (Eigen::Index j = first; j < end; ++j) X(i, j - first) = pairs.vectors.at(i, j);
      }
      const Eigen::MatrixXd weighed = X.transpose() * marks_.asDiagonal() * X;
      X *= dense_eigen(weighed).vectors;
      for (Eigen::Index i = 0; i < X.rows(); ++i) {
        for (Eigen::Index j = first; j < end; ++j) pairs.vectors.at(i, j) = X(i, j - first);
      }
    }
  }

  void accept(EigenPairs& pairs, const Cut& cut) {
    choose_in_clusters(pairs, cut);
    const Eigen::Index kept = std::min<Eigen::Index>(cut.end - cut.begin, m_ - have_);
    for (Eigen::Index i = 0; i < kept; ++i) copy_column(pairs.vectors, cut.begin + i, H_, have_ + i);
    for (Eigen::Index i = cut.begin; i < cut.end; ++i) values_.push_back(pairs.values[i]);
    have_ = static_cast<int>(values_.size());
    boundary_ = cut.at;
    const std::size_t window = std::min<std::size_t>(kSmallestBand, values_.size() - 1);
    spacing_ = (boundary_ - values_[values_.size() - 1 - window]) / static_cast<double>(window);
  }

  /// Later steps of a band cost more, since each block is orthogonalised against all before.
  void tick() {
    ++applied_;
    if (!progress_) return;
    const double band = std::min(band_, m_ - have_);
    const double steps = std::min(1.0, applied_ / std::max(1.0, 1.1 * expected_));
    const double part = 0.95 * steps * (0.5 + 0.5 * steps);
    reported_ = std::max(reported_, 0.95 * (have_ + band * part) / m_);  // retries do not take it back
    if (!progress_(reported_, stage_)) throw Cancelled();
  }

  const Laplacian& laplacian_;
  const Eigen::SparseMatrix<double>& S_;
  ShiftInvert op_;
  int m_;
  int band_;  // eigenpairs a band aims for
  const Progress& progress_;
  std::string stage_;
  Kernel kernel_;
  Panels H_;
  std::vector<double> values_;
  int have_;
  Eigen::VectorXd marks_;  // the function that choose_in_clusters diagonalises
  double boundary_ = 0, spacing_ = 0;
  int applied_ = 0, expected_ = 0;  // blocks solved for in this band
  double reported_ = 0;
};

Result<Eigenbasis> solve_dense(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, int m) {
  const DenseEigen all = dense_eigen(Eigen::MatrixXd(S));
  if (!all.converged) return fail(ErrorCode::kNumerical, "the dense eigensolver did not converge");
  Eigen::VectorXd values = all.values.head(m);
  const Kernel kernel = kernel_of(laplacian, m);
  values.head(kernel.count).setZero();
  Panels H = panels_from(all.vectors.leftCols(m));
  for (int c = 0; c < kernel.count; ++c) copy_column(kernel.vectors, c, H, c);
  return eigenbasis_from(laplacian, S, std::move(H), std::move(values));
}

enum class Method { kLanczos, kMultilevel, kSpectra };

Result<Eigenbasis> solve(const Laplacian& laplacian, int m, Method method, const Progress& progress) {
  const Eigen::Index n = laplacian.mass.size();
  if (m < 1 || 2 * Eigen::Index{m} >= n) {
    return fail(ErrorCode::kInvalidArgument, "a surface of " + std::to_string(n) + " vertices has no " +
                                                 std::to_string(m) +
                                                 " smooth harmonics: ask for fewer than half its vertices");
  }
  try {
    const double bytes = method == Method::kMultilevel ? multilevel_bytes(n, m)
                         : method == Method::kSpectra  ? spectra_bytes(n, m)
                                                       : bytes_needed(n, m);
    if (const double usable = usable_memory(); bytes > usable) {
      return fail(ErrorCode::kTooLarge, stage_text(bytes) + ": " + std::to_string(std::lround(usable * 1e-9)) +
                                            " GB are free here; ask for fewer, or simplify the surface");
    }
    if (progress && !progress(0, stage_text(bytes))) throw Cancelled();
    if (method == Method::kMultilevel) return approximate_eigenbasis(laplacian, m, {}, progress);
    const Eigen::SparseMatrix<double> S = symmetric_form(laplacian);
    if (method == Method::kSpectra) return spectra_eigenbasis(laplacian, S, m, progress);
    if (n <= kDenseLimit) return solve_dense(laplacian, S, m);
    return Bands(laplacian, S, m, progress).run();
  } catch (const Cancelled&) {
    return fail(ErrorCode::kCancelled, "stopped while solving for eigenvectors");
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for " + std::to_string(m) + " eigenvectors of " +
                                          std::to_string(n) + " vertices: ask for fewer, or simplify the surface");
  } catch (const std::exception& error) {
    return fail(ErrorCode::kNumerical, std::string("the eigensolver stopped: ") + error.what());
  }
}

}  // namespace

Result<Eigenbasis> solve_eigenbasis(const Laplacian& laplacian, int m, const Progress& progress, EigenSolver solver) {
  const Eigen::Index n = laplacian.mass.size();
  if (solver == EigenSolver::kLanczos)
    return solve(laplacian, m, n <= kExactMaxVertices ? Method::kLanczos : Method::kMultilevel, progress);
  if (n <= kSpectraMaxVertices) return solve(laplacian, m, Method::kSpectra, progress);
  return fail(ErrorCode::kTooLarge, "the solver 'spectra' takes up to " + std::to_string(kSpectraMaxVertices) +
                                        " vertices, this surface has " + std::to_string(n) +
                                        ": use the solver 'lanczos', or simplify the surface");
}
Result<Eigenbasis> solve_eigenbasis_exactly(const Laplacian& laplacian, int m, const Progress& progress) {
  return solve(laplacian, m, Method::kLanczos, progress);
}

}  // namespace eigencast
