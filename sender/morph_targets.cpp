// SPDX-License-Identifier: MIT
#include "sender/morph_targets.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "common/spectral/symmetric_form.h"
#include "common/surface/surface.h"

namespace eigencast {
namespace {

constexpr double kTolerance = 1e-4;  ///< Of the diagonal.
constexpr std::size_t kMostTargets = 512;
constexpr std::size_t kMostBytes = std::size_t{512} << 20;
constexpr int kPasses = 12;  ///< Over the clip, at most.

/// What a pose adds to the rest pose, 3 n.
using Field = Eigen::VectorXd;

class Passes {
 public:
  Passes(const MotionClip& clip, const std::function<bool(double)>& progress) : clip_(clip), progress_(progress) {}

  template <typename Visit>
  Result<void> over(const Visit& visit) {
    const std::vector<Vec3>& rest = clip_.rest().positions;
    Field field(static_cast<Eigen::Index>(3 * rest.size()));
    for (std::size_t frame = 0; frame < clip_.frame_count(); ++frame) {
      const double part = static_cast<double>(frame) / static_cast<double>(clip_.frame_count());
      if (progress_ && !progress_(1 - std::exp2(-(done_ + part) / 2)))
        return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
      const auto pose = clip_.pose(frame);
      if (!pose) return pose.error();
      for (std::size_t i = 0; i < rest.size(); ++i) {
        for (std::size_t c = 0; c < 3; ++c) field[static_cast<Eigen::Index>(3 * i + c)] = (*pose)[i][c] - rest[i][c];
      }
      visit(frame, field);
    }
    ++done_;
    return {};
  }

 private:
  const MotionClip& clip_;
  const std::function<bool(double)>& progress_;
  double done_ = 0;
};

/// Orthonormal directions that hold all fields so far to a tolerance; of more than there is room for, the principal
/// half.
class Span {
 public:
  Span(Eigen::Index size, Eigen::Index most, double tolerance)
      : D_(size, most), squares_(Eigen::MatrixXd::Zero(most, most)), tolerance_(tolerance) {}

  void add(const Field& field) {
    if (count_ == D_.cols()) turn(std::max<Eigen::Index>(count_ / 2, 1));
    Eigen::VectorXd w = D_.leftCols(count_).transpose() * field;
    Field left = field - D_.leftCols(count_) * w;
    double largest = 0;
    for (Eigen::Index i = 0; i < left.size(); i += 3) largest = std::max(largest, left.segment<3>(i).squaredNorm());
    if (std::sqrt(largest) > tolerance_ && count_ < D_.cols()) {
      left -= D_.leftCols(count_) * (D_.leftCols(count_).transpose() * left).eval();  // Gram and Schmidt, once more
      const double length = left.norm();
      D_.col(count_++) = left / length;
      w.conservativeResize(count_);
      w[count_ - 1] = length;
    }
    squares_.topLeftCorner(count_, count_) += w * w.transpose();
  }
  /// The principal ones first.
  Eigen::MatrixXd principal(Eigen::Index most) {
    turn(std::min(most, count_));
    return D_.leftCols(count_);
  }

 private:
  void turn(Eigen::Index most) {
    if (count_ == 0) return;
    const DenseEigen pairs = dense_eigen(squares_.topLeftCorner(count_, count_));  // ascending
    D_.leftCols(most) = (D_.leftCols(count_) * pairs.vectors.rightCols(most).rowwise().reverse()).eval();
    squares_.setZero();
    squares_.diagonal().head(most) = pairs.values.tail(most).reverse();
    count_ = most;
  }

  Eigen::MatrixXd D_;
  Eigen::MatrixXd squares_;  ///< Of the fields' coefficients, k x k.
  Eigen::Index count_ = 0;
  const double tolerance_;
};

struct Errors {
  double rms = 0, largest = 0;
};

}  // namespace

Result<MorphTargets> morph_targets_of(const MotionClip& clip, std::size_t targets,
                                      const std::function<bool(double)>& progress) {
  const std::size_t n = clip.rest().vertex_count(), frames = clip.frame_count();
  const double diagonal = std::max(bounding_box(clip.rest().positions).diagonal(), 1e-300);
  const std::size_t room = std::min(kMostBytes / (24 * n), 2 * kMostBytes / (8 * frames));
  const auto most = static_cast<Eigen::Index>(std::clamp<std::size_t>(room, 2, kMostTargets));
  Span span(static_cast<Eigen::Index>(3 * n), most, kTolerance / 2 * diagonal);
  Passes passes(clip, progress);
  const auto gathered = passes.over([&](std::size_t, const Field& field) { span.add(field); });
  if (!gathered) return gathered.error();
  Eigen::MatrixXd D = span.principal(targets > 0 ? static_cast<Eigen::Index>(targets) : most);
  if (D.cols() == 0) D = Eigen::MatrixXd::Zero(D.rows(), 1);  // It never moves: a target that does nothing.
  Eigen::MatrixXd weights(static_cast<Eigen::Index>(frames), D.cols());
  Eigen::VectorXd squares(weights.rows());
  const auto weighed = passes.over([&](std::size_t frame, const Field& field) {
    const auto t = static_cast<Eigen::Index>(frame);
    weights.row(t) = (D.transpose() * field).transpose();
    squares[t] = field.squaredNorm();
  });
  if (!weighed) return weighed.error();

  const auto errors_of = [&](Eigen::Index count) -> Result<Errors> {
    double sum = 0, largest = 0;
    const auto measured = passes.over([&](std::size_t frame, const Field& field) {
      const Field rest =
          field - D.leftCols(count) * weights.row(static_cast<Eigen::Index>(frame)).head(count).transpose();
      sum += rest.squaredNorm();
      for (Eigen::Index i = 0; i < rest.size(); i += 3) largest = std::max(largest, rest.segment<3>(i).squaredNorm());
    });
    if (!measured) return measured.error();
    return Errors{std::sqrt(sum / static_cast<double>(n * frames)) / diagonal, std::sqrt(largest) / diagonal};
  };
  // By the error of all vertices of a pose together, which is known of any number, until that of each is small enough.
  const auto fewest_for = [&](double rms) {
    const double allowed = std::pow(rms * diagonal, 2) * static_cast<double>(n);
    Eigen::VectorXd left = squares;
    Eigen::Index count = 0;
    while (count < D.cols() && (count == 0 || left.maxCoeff() > allowed)) {
      left -= weights.col(count).cwiseAbs2();
      ++count;
    }
    return count;
  };
  Eigen::Index count = targets > 0 ? D.cols() : fewest_for(kTolerance / 2);
  auto errors = errors_of(count);
  double rms = kTolerance / 2;
  for (int pass = 3; errors && targets == 0 && errors->largest > kTolerance && count < D.cols() && pass < kPasses;
       ++pass) {
    rms *= std::clamp(kTolerance / errors->largest, 0.25, 0.9);
    count = std::max(count + 1, fewest_for(rms));
    errors = errors_of(count);
  }
  if (!errors) return errors.error();

  MorphTargets result;
  result.rms_error = errors->rms;
  result.largest_error = errors->largest;
  MorphedMotion& motion = result.motion;
  motion.targets = static_cast<std::size_t>(count);
  motion.frames = frames;
  Field base(D.rows());
  for (Eigen::Index i = 0; i < base.size(); ++i)
    base[i] = clip.rest().positions[static_cast<std::size_t>(i / 3)][static_cast<std::size_t>(i % 3)];
  for (Eigen::Index k = 0; k < count; ++k) {
    const double low = weights.col(k).minCoeff(), range = weights.col(k).maxCoeff() - low;
    const double scale = range > 0 ? range : 1;
    base += low * D.col(k);
    for (Eigen::Index i = 0; i < D.rows(); ++i) motion.offsets.push_back(static_cast<float>(D(i, k) * scale));
    weights.col(k) = (weights.col(k).array() - low) / scale;
  }
  for (Eigen::Index i = 0; i < base.size(); ++i) motion.base.push_back(static_cast<float>(base[i]));
  for (Eigen::Index t = 0; t < weights.rows(); ++t)
    for (Eigen::Index k = 0; k < count; ++k) motion.weights.push_back(static_cast<float>(weights(t, k)));
  return result;
}

}  // namespace eigencast
