// SPDX-License-Identifier: MIT
#include "common/spectral/eigenbasis.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "common/spectral/symmetric_form.h"
#include "support.h"

namespace eigencast {
namespace {

using testing::orthonormality_defect;

Laplacian laplacian_of(const Surface& surface, bool bridge = true) {
  auto laplacian = build_laplacian(surface, {.bridge = bridge});
  EXPECT_TRUE(laplacian);
  return std::move(*laplacian);
}

/// Lowest eigenvalues by a dense solver.
Eigen::VectorXd dense_spectrum(const Laplacian& laplacian, int m) {
  const Eigen::VectorXd scale = laplacian.mass.cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd S = scale.asDiagonal() * Eigen::MatrixXd(laplacian.L) * scale.asDiagonal();
  return dense_eigen(S).values.head(m);
}

void expect_eigenpairs(const Laplacian& laplacian, const Eigenbasis& basis) {
  EXPECT_TRUE(basis.certified);
  EXPECT_LE(orthonormality_defect(basis.Phi, laplacian.mass), 1e-10);
  EXPECT_LE(basis.residual, 1e-8);
  const Eigen::MatrixXd left = laplacian.L * basis.Phi;
  const Eigen::MatrixXd right = laplacian.mass.asDiagonal() * basis.Phi * basis.eigenvalues.asDiagonal();
  const Eigen::VectorXd root = laplacian.mass.cwiseSqrt();
  const double first_nonzero =
      *std::find_if(basis.eigenvalues.begin(), basis.eigenvalues.end() - 1, [](double v) { return v > 0; });
  for (Eigen::Index j = 0; j < basis.Phi.cols(); ++j) {
    const double defect = (left.col(j) - right.col(j)).cwiseQuotient(root).norm();
    EXPECT_LE(defect, 1e-8 * std::max(basis.eigenvalues[j], first_nonzero)) << "column " << j;
  }
  EXPECT_TRUE(std::is_sorted(basis.eigenvalues.begin(), basis.eigenvalues.end()));
}

TEST(Eigenbasis, SphereHasItsEigenvaluesAndMultiplicities) {
  const Surface sphere = make_icosphere(4);  // its symmetry makes clusters of up to 5 exactly equal eigenvalues
  const Laplacian laplacian = laplacian_of(sphere);
  const auto basis = solve_eigenbasis(laplacian, 100);
  ASSERT_TRUE(basis) << basis.error().message;
  expect_eigenpairs(laplacian, *basis);
  Eigen::Index j = 0;
  for (int l = 0; l < 10; ++l) {
    for (int copy = 0; copy < 2 * l + 1; ++copy, ++j) {
      EXPECT_NEAR(basis->eigenvalues[j], l * (l + 1), 0.05 * l * (l + 1)) << "l = " << l << ", copy " << copy;
    }
  }
}

TEST(Eigenbasis, CutInsideAClusterStaysComplete) {
  const Laplacian laplacian = laplacian_of(make_icosphere(3));
  const Eigen::VectorXd truth = dense_spectrum(laplacian, 60);
  for (const int m : {2, 3, 6, 37, 60}) {
    const auto basis = solve_eigenbasis(laplacian, m);
    ASSERT_TRUE(basis) << basis.error().message;
    expect_eigenpairs(laplacian, *basis);
    EXPECT_LE((basis->eigenvalues - truth.head(m)).cwiseAbs().maxCoeff(), 1e-8 * truth[59]) << m;
  }
}

TEST(Eigenbasis, BandsMatchADenseSolver) {
  for (const Surface& surface : {make_torus(40, 20, 1.0, 0.4), make_box(6, 9, 12, {1, 1, 3})}) {
    const Laplacian laplacian = laplacian_of(surface);
    const int m = static_cast<int>(surface.vertex_count()) * 2 / 5;
    const Eigen::VectorXd truth = dense_spectrum(laplacian, m);
    const auto basis = solve_eigenbasis(laplacian, m);
    ASSERT_TRUE(basis) << basis.error().message;
    expect_eigenpairs(laplacian, *basis);
    EXPECT_LE((basis->eigenvalues - truth).cwiseAbs().maxCoeff(), 1e-8 * truth[m - 1]);
  }
}

/// Each l of the sphere has 2 l + 1 equal eigenvalues, here split by the mesh: none may be lost where bands meet.
TEST(Eigenbasis, SphereIsCompleteAcrossBands) {
  const Laplacian laplacian = laplacian_of(make_icosphere(3));
  const auto basis = solve_eigenbasis(laplacian, 250);  // 642 vertices: bands of 80
  ASSERT_TRUE(basis) << basis.error().message;
  expect_eigenpairs(laplacian, *basis);
  const Eigen::VectorXd truth = dense_spectrum(laplacian, 250);
  EXPECT_LE((basis->eigenvalues - truth).cwiseAbs().maxCoeff(), 1e-8 * truth[249]);
}

TEST(Eigenbasis, FirstHarmonicIsConstant) {
  const Laplacian laplacian = laplacian_of(make_torus(50, 25, 1.0, 0.4));
  const auto basis = solve_eigenbasis(laplacian, 20);
  ASSERT_TRUE(basis);
  EXPECT_EQ(basis->eigenvalues[0], 0);
  EXPECT_LE((basis->Phi.col(0).array().abs() - 1 / std::sqrt(laplacian.area)).abs().maxCoeff(), 1e-12);
}

TEST(Eigenbasis, EigenvaluesScaleWithTheInverseSquare) {
  Surface surface = make_torus(40, 20, 1.0, 0.4);
  const auto one = solve_eigenbasis(laplacian_of(surface), 40);
  for (const double s : {1e-5, 1e4}) {
    Surface other = surface;
    other.positions = testing::scaled(surface.positions, s);
    const auto basis = solve_eigenbasis(laplacian_of(other), 40);
    ASSERT_TRUE(one && basis);
    EXPECT_LE((basis->eigenvalues * s * s - one->eigenvalues).cwiseAbs().maxCoeff(), 1e-8 * one->eigenvalues[39]);
  }
}

TEST(Eigenbasis, UnbridgedComponentsSpanTheKernel) {
  const Surface surface = testing::side_by_side(std::vector<Surface>(5, make_icosphere(2)), 3);
  const Laplacian laplacian = laplacian_of(surface, false);
  const auto basis = solve_eigenbasis(laplacian, 30);
  ASSERT_TRUE(basis) << basis.error().message;
  expect_eigenpairs(laplacian, *basis);
  EXPECT_LE(basis->eigenvalues.head(5).maxCoeff(), 0);
  EXPECT_GT(basis->eigenvalues[5], 1);
  const auto few = solve_eigenbasis(laplacian, 3);  // fewer than there are components
  ASSERT_TRUE(few);
  EXPECT_LE(orthonormality_defect(few->Phi, laplacian.mass), 1e-12);
}

TEST(Eigenbasis, ProgressGrowsAndEndsAtOne) {
  const Laplacian laplacian = laplacian_of(make_torus(60, 30, 1.0, 0.4));
  double last = 0;
  int calls = 0;
  const auto basis = solve_eigenbasis(laplacian, 120, [&](double fraction, std::string_view) {
    EXPECT_GE(fraction, 0);
    EXPECT_LE(fraction, 1);
    last = fraction;
    ++calls;
    return true;
  });
  ASSERT_TRUE(basis);
  EXPECT_GT(calls, 20);
  EXPECT_EQ(last, 1);
}

TEST(Eigenbasis, StopsWhenAskedTo) {
  const Laplacian laplacian = laplacian_of(make_torus(60, 30, 1.0, 0.4));
  for (const int allowed : {0, 1, 10, 40}) {
    int calls = 0;
    const auto basis = solve_eigenbasis(laplacian, 120, [&](double, std::string_view) { return calls++ < allowed; });
    ASSERT_FALSE(basis);
    EXPECT_EQ(basis.error().code, ErrorCode::kCancelled);
    EXPECT_EQ(calls, allowed + 1);  // not asked again after it said no
  }
}

TEST(Eigenbasis, RefusesTooManyPairs) {
  const Laplacian laplacian = laplacian_of(make_icosphere(1));
  EXPECT_EQ(solve_eigenbasis(laplacian, 21).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(solve_eigenbasis(laplacian, 0).error().code, ErrorCode::kInvalidArgument);
  EXPECT_TRUE(solve_eigenbasis(laplacian, 20));
}

TEST(Eigenbasis, SameInputSameBits) {
  const Laplacian laplacian = laplacian_of(make_torus(40, 20, 1.0, 0.4));
  const auto a = solve_eigenbasis(laplacian, 60);
  const auto b = solve_eigenbasis(laplacian, 60);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->Phi, b->Phi);
}

}  // namespace
}  // namespace eigencast
