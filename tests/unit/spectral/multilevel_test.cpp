// SPDX-License-Identifier: MIT
#include "common/spectral/multilevel.h"

#include <numeric>

#include "support.h"

namespace eigencast {
namespace {

TEST(Coarsening, KeepsConstantsAreaAndPieces) {
  const Surface two = testing::side_by_side({make_icosphere(4), make_torus(60, 30, 1, 0.4)}, 4);
  const auto fine = build_laplacian(two, {.bridge = false});
  ASSERT_TRUE(fine);
  const Coarsened coarse = coarsen(*fine);
  const Eigen::Index n = fine->L.rows(), nc = coarse.laplacian.L.rows();
  EXPECT_LT(nc, n / 5);
  EXPECT_GT(nc, n / 16);
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(nc);
  EXPECT_LE((coarse.P * ones - Eigen::VectorXd::Ones(n)).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_NEAR(coarse.laplacian.mass.sum(), fine->area, 1e-9);
  EXPECT_LE((coarse.laplacian.L * ones).cwiseAbs().maxCoeff(), 1e-10);
  // A function that is 1 on one piece and 0 on the other has no energy.
  Eigen::VectorXd piece = Eigen::VectorXd::Zero(nc);
  for (Eigen::Index i = 0; i < n; ++i) {
    if (two.positions[static_cast<std::size_t>(i)][0] > 2) continue;
    for (decltype(coarse.P)::InnerIterator it(coarse.P, i); it; ++it) piece[it.col()] = 1;
  }
  EXPECT_LE(piece.dot(coarse.laplacian.L * piece), 1e-10);
}

TEST(Multilevel, EigenvaluesMatchTheExactSolver) {
  const Surface heart = make_heart(40);  // 16,002 vertices
  const auto laplacian = build_laplacian(heart);
  ASSERT_TRUE(laplacian);
  const int m = 80;
  const auto exact = solve_eigenbasis_exactly(*laplacian, m);
  const auto rough = approximate_eigenbasis(*laplacian, m, {.coarse_vertices = 1500});
  ASSERT_TRUE(exact && rough) << rough.error().message;
  EXPECT_TRUE(rough->approximate);
  EXPECT_FALSE(rough->certified);
  EXPECT_EQ(rough->missed, 0);
  EXPECT_GT(rough->residual, exact->residual);
  EXPECT_EQ(rough->eigenvalues[0], 0);
  EXPECT_LE(testing::orthonormality_defect(rough->Phi, laplacian->mass), 1e-10);
  for (int k = 1; k < m; ++k) {
    EXPECT_GE(rough->eigenvalues[k], exact->eigenvalues[k] * (1 - 1e-9)) << k;  // Ritz values lie above
    EXPECT_LE(rough->eigenvalues[k], exact->eigenvalues[k] * 1.01) << k;
  }
}

TEST(Multilevel, RebuildsABentPoseEquallyWell) {
  const Surface heart = make_heart(40);
  const auto laplacian = build_laplacian(heart);
  ASSERT_TRUE(laplacian);
  const std::vector<Vec3> pose = testing::bent(heart.positions);
  const auto error_of = [&](const Eigenbasis& basis) {
    const Eigen::MatrixXd X = testing::matrix_from(pose);
    return (X - basis.Phi * (basis.Phi.transpose() * laplacian->mass.asDiagonal() * X)).norm();
  };
  const auto exact = solve_eigenbasis_exactly(*laplacian, 60);
  const auto rough = approximate_eigenbasis(*laplacian, 60, {.coarse_vertices = 2000});
  ASSERT_TRUE(exact && rough);
  EXPECT_LE(error_of(*rough), 1.02 * error_of(*exact));
}

TEST(Multilevel, IsCancelled) {
  const auto laplacian = build_laplacian(make_heart(30));
  ASSERT_TRUE(laplacian);
  double last = 0;
  const auto stop = [&](double fraction, std::string_view) {
    EXPECT_GE(fraction, last);
    last = fraction;
    return fraction < 0.4;
  };
  const auto rough = approximate_eigenbasis(*laplacian, 40, {.coarse_vertices = 1500}, stop);
  ASSERT_FALSE(rough);
  EXPECT_EQ(rough.error().code, ErrorCode::kCancelled);
}

// Nothing to coarsen: every vertex is a piece of its own.
TEST(Multilevel, FallsBackToTheExactSolver) {
  const auto laplacian = build_laplacian(make_icosphere(4));
  ASSERT_TRUE(laplacian);
  const auto same = approximate_eigenbasis(*laplacian, 30, {.coarse_vertices = 1 << 20});
  ASSERT_TRUE(same);
  EXPECT_TRUE(same->certified);
  EXPECT_FALSE(same->approximate);
}

}  // namespace
}  // namespace eigencast
