// SPDX-License-Identifier: MIT
#include "common/spectral/prefix_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace eigencast {
namespace {

// Of the largest column's squared norm: columns that are nought at these vertices get no coefficients.
constexpr double kRidge = 1e-11;

Eigen::MatrixXd gram_of(const Eigen::MatrixXd& A) {
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(A.cols(), A.cols());
  G.selfadjointView<Eigen::Lower>().rankUpdate(A.transpose());
  return G.selfadjointView<Eigen::Lower>();
}

}  // namespace

PrefixFit::PrefixFit(const Eigen::MatrixXd& rows, const Eigen::VectorXd& mass, const Eigen::MatrixXd& poses,
                     double vertices)
    : poses_squared_(poses.squaredNorm()),
      vertices_(static_cast<double>(rows.rows())),
      all_vertices_(vertices),
      gram_(gram_of(rows)),
      B_(rows.transpose() * poses) {
  const Eigen::VectorXd roots = mass.cwiseSqrt();
  Eigen::MatrixXd weighted = gram_of(roots.cwiseSqrt().asDiagonal() * rows);
  weighted.diagonal().array() += kRidge * weighted.diagonal().maxCoeff();
  L_ = weighted.llt().matrixL();
  y_ = L_.triangularView<Eigen::Lower>().solve(rows.transpose() * (roots.asDiagonal() * poses));
}

Eigen::MatrixXd PrefixFit::coefficients(int r) const {
  return L_.topLeftCorner(r, r).triangularView<Eigen::Lower>().transpose().solve(y_.topRows(r));
}

double PrefixFit::squared_error(const Eigen::MatrixXd& C) const {
  const Eigen::Index r = C.rows();
  const double left =
      poses_squared_ - 2 * C.cwiseProduct(B_.topRows(r)).sum() + C.cwiseProduct(gram_.topLeftCorner(r, r) * C).sum();
  const double poses = static_cast<double>(C.cols()) / 3;
  // What r columns fit of N vertices by chance, where there are more.
  const double chance =
      1 + (1 - vertices_ / all_vertices_) * static_cast<double>(r) / std::max(vertices_ - static_cast<double>(r), 1.0);
  return std::max(left, 0.0) * chance / (vertices_ * poses);
}

}  // namespace eigencast
