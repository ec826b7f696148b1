// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <new>
#include <string>

#include "common/spectral/augment.h"
#include "common/spectral/basis.h"
#include "common/spectral/symmetric_form.h"

namespace eigencast {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kNothing = 3e-7;       // relative length of a zero column; its square exceeds a Gram matrix's rounding
constexpr Index kSpare = 24;            // components kept beyond the wanted ones until the last pose
constexpr Index kPanelsAtOnce = 16;     // panels of poses between two updates of the components
constexpr double kUnusedShare = 1e-10;  // weight of columns that no pose needs, relative to the poses' variance

/// The symmetric form h = M^{1/2} psi. The affine columns are projected out of all others.
struct Form {
  VectorXd root_mass;
  MatrixXd affine;  // n x a
  Eigen::RowVector3d centre;

  Form(const Surface& surface, const VectorXd& mass)
      : root_mass(mass.cwiseSqrt()),
        affine(candidates_from(surface.positions, mass).affine),
        centre(mass.transpose() * matrix_from_positions(surface.positions) / mass.sum()) {}

  VectorXd without_affine(VectorXd h) const {
    for (int pass = 0; pass < 2; ++pass) h -= affine * (affine.transpose() * h);
    return h;
  }
};

/// The poses' coordinates, eight columns at a time, without their affine part.
class PoseColumns {
 public:
  PoseColumns(const KnownMotion& motion, const Form& form, const Progress& progress)
      : motion_(motion), form_(form), progress_(progress), count_(motion.samples()) {
    affine_squares_ = VectorXd::Zero(form.affine.cols());
  }

  std::size_t count() const { return count_; }
  /// Fills a panel; false, and nothing filled, at the end.
  Result<bool> next(double* panel) {
    while (static_cast<Index>(waiting_.size()) < kWidth && read_ < count_) {
      if (auto read = read_pose(); !read) return read.error();
    }
    if (waiting_.empty()) return false;
    const Index columns = std::min<Index>(kWidth, static_cast<Index>(waiting_.size()));
    for (Index j = 0; j < columns; ++j) {
      const VectorXd& column = waiting_[static_cast<std::size_t>(j)];
      for (Index i = 0; i < column.size(); ++i) panel[i * kWidth + j] = column[i];
    }
    waiting_.erase(waiting_.begin(), waiting_.begin() + columns);
    return true;
  }

  /// Sums of squares over the poses read: of each affine coefficient; of the part outside the affine columns; of all
  /// but the constant column, which only translates.
  const VectorXd& affine_squares() const { return affine_squares_; }
  double other_squares() const { return other_squares_; }
  double shape_squares() const { return affine_squares_.tail(affine_squares_.size() - 1).sum() + other_squares_; }

 private:
  Result<void> read_pose() {
    if (progress_ && !progress_(static_cast<double>(read_) / static_cast<double>(count_), "learning from poses"))
      return fail(ErrorCode::kCancelled, "stopped while learning from pose " + std::to_string(read_));
    const std::size_t number = read_++;
    const auto pose = motion_.sample(number);
    if (!pose) return pose.error();
    if (static_cast<Index>(pose->size()) != form_.root_mass.size()) {
      return fail(ErrorCode::kInvalidArgument, "pose " + std::to_string(number) + " has " +
                                                   std::to_string(pose->size()) + " vertices, the rest pose " +
                                                   std::to_string(form_.root_mass.size()));
    }
    const PositionMap X = matrix_from_positions(*pose);
    for (Index axis = 0; axis < 3; ++axis) {
      const VectorXd h = (X.col(axis).array() - form_.centre[axis]) * form_.root_mass.array();
      const VectorXd c = form_.affine.transpose() * h;
      if (!c.allFinite()) return fail(ErrorCode::kInvalidArgument, "pose " + std::to_string(number) + " is not finite");
      affine_squares_ += c.cwiseAbs2();
      waiting_.push_back(form_.without_affine(h));
      other_squares_ += waiting_.back().squaredNorm();
    }
    return {};
  }

  const KnownMotion& motion_;
  const Form& form_;
  const Progress& progress_;
  std::size_t count_, read_ = 0;
  std::vector<VectorXd> waiting_;
  VectorXd affine_squares_;
  double other_squares_ = 0;
};

/// Eigenpairs of a Gram or covariance matrix, the largest first.
struct Principal {
  MatrixXd vectors;
  VectorXd values;
  /// How many values are above `least`.
  Index above(double least) const {
    Index count = 0;
    while (count < values.size() && values[count] > least) ++count;
    return count;
  }
};

Principal principal_of(const MatrixXd& symmetric) {
  const DenseEigen pairs = dense_eigen(symmetric);
  return {pairs.vectors.rowwise().reverse(), pairs.values.reverse()};
}

/// H = H T for T of any width, filled up with zeros to whole panels.
void rotate_to(Panels& H, const MatrixXd& T) {
  MatrixXd padded = MatrixXd::Zero(H.columns(), whole_panels(T.cols()));
  padded.topLeftCorner(T.rows(), T.cols()) = T;
  rotate(H, padded);
}

/// Orthonormal columns beside the affine ones, with the variance of their coefficients over the poses.
struct Directions {
  Panels Q;
  Index count = 0;
  VectorXd squares = {};  // count: sums over the poses
  Index dimensions = 0;   // count before truncation
};

Result<void> clean(Directions& directions, const Form& form) {
  MatrixXd X = matrix_from(directions.Q, directions.Q.columns());
  for (Index j = 0; j < X.cols(); ++j) X.col(j) = form.without_affine(X.col(j));
  directions.Q = panels_from(X);
  if (orthonormalise(directions.Q, directions.count) && orthonormalise(directions.Q, directions.count)) return {};
  return fail(ErrorCode::kNumerical, "the columns of this motion are not independent: take another basis");
}

/// The given columns without their affine part, of unit length, zero where nothing remains.
Panels unit_columns(const SpanningColumns& given, const Form& form, VectorXd& lengths) {
  const auto c = static_cast<Index>(given.count);
  const Index n = form.root_mass.size();
  const Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> W(given.W.data(), n,
                                                                                                   c);
  MatrixXd columns = MatrixXd::Zero(n, c);
  lengths = VectorXd::Zero(c);
  for (Index j = 0; j < c; ++j) {
    const VectorXd whole = form.root_mass.cwiseProduct(W.col(j));
    const VectorXd h = form.without_affine(whole);
    const double length = h.norm();
    if (!(length > kNothing * whole.norm())) continue;
    lengths[j] = length;
    columns.col(j) = h / length;
  }
  return panels_from(columns);
}

/// An orthonormal basis of the given columns' span; `reach` is their Gram matrix in that basis (k x k).
Result<Directions> spanned_by(const SpanningColumns& given, const Form& form, MatrixXd& reach) {
  VectorXd lengths;
  Directions directions{unit_columns(given, form, lengths)};
  Panels& Q = directions.Q;
  const auto c = static_cast<Index>(given.count);
  const Principal principal = principal_of(gram(Q).topLeftCorner(c, c));
  const Index k = principal.above(kNothing * kNothing * principal.values[0]);
  directions.count = directions.dimensions = k;
  const VectorXd roots = principal.values.head(k).cwiseSqrt();
  rotate_to(Q, principal.vectors.leftCols(k) * roots.cwiseInverse().asDiagonal());
  const MatrixXd K = roots.asDiagonal() * principal.vectors.leftCols(k).transpose() * lengths.asDiagonal();
  reach = K * K.transpose();
  if (auto cleaned = clean(directions, form); !cleaned) return cleaned.error();
  return directions;
}

/// Rotates them so that each prefix captures the most variance of the poses, and keeps at most `limit`.
Result<void> order(Directions& directions, const MatrixXd& reach, PoseColumns& poses, Index limit) {
  const Index k = directions.count;
  if (k == 0) return {};
  MatrixXd covariance = MatrixXd::Zero(k, k);
  Panels panel(directions.Q.rows());
  panel.append();
  for (;;) {
    std::fill_n(panel[0], directions.Q.rows() * kWidth, 0.0);
    const auto more = poses.next(panel[0]);
    if (!more) return more.error();
    if (!*more) break;
    const MatrixXd C = transposed_product(directions.Q, 0, directions.Q.count(), panel[0]).topRows(k);
    covariance += C * C.transpose();
  }
  const double captured = covariance.trace();
  const double unit = captured > 0 ? kUnusedShare * captured : 1;
  const Principal principal = principal_of(covariance + unit / std::max(reach.trace(), 1e-300) * reach);
  directions.count = std::min(k, limit);
  const MatrixXd T = principal.vectors.leftCols(directions.count);
  directions.squares = (T.transpose() * covariance * T).diagonal().cwiseMax(0);
  rotate_to(directions.Q, T);
  return {};
}

/// The first `limit` principal components of the poses.
Result<Directions> learnt_from(PoseColumns& poses, const Form& form, Index limit) {
  Directions directions{Panels(form.root_mass.size())};
  Panels& H = directions.Q;  // components times the root of their sums of squares, then new poses
  Principal principal;
  Index kept = 0;
  for (bool more = true; more;) {
    const Index before = H.count();
    while (more && H.count() < before + kPanelsAtOnce) {
      const auto filled = poses.next(H.append());
      if (!filled) return filled.error();
      more = *filled;
    }
    principal = principal_of(gram(H));
    kept = std::min(principal.above(kNothing * kNothing * poses.shape_squares()), more ? limit + kSpare : limit);
    rotate_to(H, principal.vectors.leftCols(kept));
  }
  directions.count = directions.dimensions = kept;
  directions.squares = principal.values.head(kept);
  if (kept == 0) return directions;
  rotate_to(H, MatrixXd(directions.squares.cwiseSqrt().cwiseInverse().asDiagonal()));
  if (auto cleaned = clean(directions, form); !cleaned) return cleaned.error();
  return directions;
}

Basis motion_basis_from(const Form& form, const Laplacian& laplacian, const Directions& directions,
                        const PoseColumns& poses) {
  const Index a = form.affine.cols();
  Basis basis;
  basis.certified = true;
  basis.mass = laplacian.mass;
  basis.area = laplacian.area;
  basis.dimensions = static_cast<int>(a + directions.dimensions);
  basis.Psi.resize(form.root_mass.size(), a + directions.count);
  basis.Psi.leftCols(a) = form.affine;
  basis.Psi.rightCols(directions.count) = matrix_from(directions.Q, directions.count);
  basis.Psi.array().colwise() /= form.root_mass.array();
  if (poses.count() == 0) return basis;
  basis.rms.resize(a + directions.count);
  basis.rms << poses.affine_squares(), directions.squares;
  basis.rms = (basis.rms / static_cast<double>(poses.count())).cwiseSqrt();
  const double all = poses.shape_squares();
  const double lost = poses.other_squares() - directions.squares.sum();
  basis.left_out = all > 0 ? std::sqrt(std::max(0.0, lost / all)) : 0;
  return basis;
}

Result<Basis> build(const Surface& rest, const Laplacian& laplacian, const KnownMotion& motion, int rank,
                    const Progress& progress) {
  const Form form(rest, laplacian.mass);
  const Index n = form.root_mass.size();
  const Index limit = std::max<Index>(0, std::min<Index>(rank, n) - form.affine.cols());
  PoseColumns poses(motion, form, progress);
  if (motion.columns.count == 0) {
    auto directions = learnt_from(poses, form, limit);
    if (!directions) return directions.error();
    return motion_basis_from(form, laplacian, *directions, poses);
  }
  MatrixXd reach;
  auto directions = spanned_by(motion.columns, form, reach);
  if (!directions) return directions.error();
  if (auto ordered = order(*directions, reach, poses, limit); !ordered) return ordered.error();
  return motion_basis_from(form, laplacian, *directions, poses);
}

}  // namespace

Result<Basis> build_motion_basis(const Surface& rest, const Laplacian& laplacian, const KnownMotion& motion, int rank,
                                 const Progress& progress) {
  const SpanningColumns& columns = motion.columns;
  const std::size_t n = rest.vertex_count();
  if (static_cast<std::size_t>(laplacian.mass.size()) != n || columns.W.size() != n * columns.count) {
    return fail(ErrorCode::kInvalidArgument, "the columns of this motion, or the Laplacian, belong to another surface");
  }
  if (columns.count == 0 && motion.poses < 2) {
    return fail(
        ErrorCode::kInvalidArgument,
        "a basis is learned from the poses of a clip, and there is only one here: give a clip, or another basis");
  }
  if (columns.count > SpanningColumns::kMaxColumns) {
    return fail(ErrorCode::kTooLarge, std::to_string(columns.count) + " columns are more than the " +
                                          std::to_string(SpanningColumns::kMaxColumns) + " that a basis is made of");
  }
  try {
    return build(rest, laplacian, motion, rank, progress);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for a basis of " + std::to_string(n) + " vertices");
  }
}

}  // namespace eigencast
