// SPDX-License-Identifier: MIT
#include "common/spectral/symmetric_form.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <vector>

namespace eigencast {
namespace {

/// The largest ||S h_j - lambda_j h_j||, relative to lambda_j, or to the first positive eigenvalue where that is
/// larger.
double worst_residual(const Eigen::SparseMatrix<double>& S, const Panels& H, const Eigen::VectorXd& values) {
  const auto positive = std::find_if(values.begin(), values.end(), [](double value) { return value > 0; });
  const double floor = positive != values.end() ? *positive : 0;
  Eigen::VectorXd shift = Eigen::VectorXd::Zero(H.columns());
  shift.head(values.size()) = values;
  std::vector<double> worst(static_cast<std::size_t>(H.count()), 0.0);
  const SparseRows rows{S.outerIndexPtr(), S.innerIndexPtr(), S.valuePtr()};  // its columns, as it is symmetric
  for_panels(H.count(), [&](Eigen::Index panel) {
    Panels defects = zero_panels(H.rows(), 1);
    panel_functions().multiply(rows, 0, static_cast<std::size_t>(H.rows()), H[panel], shift.data() + panel * kWidth,
                               defects[0]);
    const Eigen::Map<const Eigen::Matrix<double, kWidth, Eigen::Dynamic>> columns(defects[0], kWidth, H.rows());
    const Eigen::VectorXd norms = columns.rowwise().norm();
    for (Eigen::Index j = 0; j < kWidth && panel * kWidth + j < values.size(); ++j) {
      const double scale = std::max(values[panel * kWidth + j], floor);
      double& most = worst[static_cast<std::size_t>(panel)];
      most = std::max(most, scale > 0 ? norms[j] / scale : norms[j]);
    }
  });
  return *std::max_element(worst.begin(), worst.end());
}

DenseEigen taken_from(const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>& solver) {
  return {solver.eigenvalues(), solver.eigenvectors(), solver.info() == Eigen::Success};
}

}  // namespace

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

Kernel kernel_of(const Laplacian& laplacian, int max) {
  const ComponentLabels labels = components_from_pattern(laplacian.L);
  const Eigen::Index n = laplacian.mass.size();
  const auto count = static_cast<int>(std::min<Eigen::Index>(max, Eigen::Index{labels.count}));
  Kernel kernel{zero_panels(n, count), count};
  Eigen::VectorXd area = Eigen::VectorXd::Zero(count);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index c = labels.of_vertex[static_cast<std::size_t>(i)];
    if (c < count) area[c] += laplacian.mass[i];
  }
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index c = labels.of_vertex[static_cast<std::size_t>(i)];
    if (c < count) kernel.vectors.at(i, c) = std::sqrt(laplacian.mass[i] / area[c]);
  }
  return kernel;
}

Result<Eigenbasis> eigenbasis_from(const Laplacian& laplacian, const Eigen::SparseMatrix<double>& S, Panels H,
                                   Eigen::VectorXd values, const std::string& vectors) {
  if (!orthonormalise(H, values.size())) return fail(ErrorCode::kNumerical, vectors + " are not independent");
  Eigenbasis result;
  result.residual = worst_residual(S, H, values);
  result.certified = true;
  result.Phi = matrix_from(H, values.size());
  result.Phi.array().colwise() *= laplacian.mass.cwiseSqrt().cwiseInverse().array();
  result.eigenvalues = std::move(values);
  return result;
}

DenseEigen dense_eigen(const Eigen::MatrixXd& A) {
  return taken_from(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A));
}

DenseEigen dense_eigen(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  return taken_from(Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(A, B));
}

}  // namespace eigencast
