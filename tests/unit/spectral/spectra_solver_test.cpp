// SPDX-License-Identifier: MIT
#include "common/spectral/symmetric_form.h"

#include "support.h"

namespace eigencast {
namespace {

Laplacian unbridged(const Surface& surface) {
  auto laplacian = build_laplacian(surface, {.bridge = false});
  EXPECT_TRUE(laplacian);
  return std::move(*laplacian);
}

/// A ball with a head and four limbs: no two eigenvalues are equal, some are close.
Surface body() {
  Surface surface = make_icosphere(4);
  const std::vector<Vec3> limbs = {{0, 1, 0.1}, {1, 0.5, 0}, {-1, 0.5, 0.05}, {0.5, -1, 0}, {-0.5, -1, 0.1}};
  for (Vec3& p : surface.positions) {
    double radius = 1;
    for (const Vec3& limb : limbs) {
      const double length = std::hypot(limb[0], limb[1], limb[2]);
      const double cosine = (p[0] * limb[0] + p[1] * limb[1] + p[2] * limb[2]) / length;
      radius += 1.5 * length * std::exp(12 * (cosine - 1));
    }
    p = {radius * p[0], radius * p[1], 0.6 * radius * p[2]};
  }
  return surface;
}

/// The sine of the largest principal angle between the spans of two sets of M-orthonormal columns.
double sine_between(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::VectorXd& mass) {
  const Eigen::MatrixXd outside = B - A * (A.transpose() * mass.asDiagonal() * B);
  const Eigen::MatrixXd gram = outside.transpose() * mass.asDiagonal() * outside;
  return std::sqrt(gram.trace());  // not less than the largest sine
}

/// Both solvers: the kernel alone, eigenvalues to 1e-8, and the spans of clusters that a relative gap of 1e-4 separates
/// to 1e-6. The cluster that m cuts is left out.
void expect_agreement(const Laplacian& laplacian, int m) {
  const auto a = solve_eigenbasis(laplacian, m);
  const auto b = solve_eigenbasis(laplacian, m, {}, EigenSolver::kSpectra);
  ASSERT_TRUE(a && b) << (a ? b.error().message : a.error().message);
  EXPECT_TRUE(b->certified);
  EXPECT_LE(b->residual, 1e-8);
  EXPECT_LE(testing::orthonormality_defect(b->Phi, laplacian.mass), 1e-10);
  const Eigen::Index kernel = laplacian.components;
  EXPECT_EQ(a->eigenvalues.head(kernel), b->eigenvalues.head(kernel));
  EXPECT_EQ(b->eigenvalues.head(kernel).cwiseAbs().maxCoeff(), 0);
  EXPECT_LE(sine_between(a->Phi.leftCols(kernel), b->Phi.leftCols(kernel), laplacian.mass), 1e-12);
  const Eigen::ArrayXd relative = (a->eigenvalues - b->eigenvalues).array().abs() / a->eigenvalues.array();
  EXPECT_LE(relative.tail(m - kernel).maxCoeff(), 1e-8);
  double worst = 0;
  int clusters = 0;
  for (Eigen::Index first = kernel, end = first; end < m; first = end) {
    for (++end; end < m && a->eigenvalues[end] - a->eigenvalues[end - 1] <= 1e-4 * a->eigenvalues[end];) ++end;
    if (end == m) break;
    const Eigen::Index count = end - first;
    worst =
        std::max(worst, sine_between(a->Phi.middleCols(first, count), b->Phi.middleCols(first, count), laplacian.mass));
    ++clusters;
  }
  EXPECT_LE(worst, 1e-6) << clusters << " clusters";
  EXPECT_GE(clusters, 8);
}

TEST(SpectraSolver, AgreesOnASphere) {
  expect_agreement(unbridged(make_icosphere(4)), 121);
}

TEST(SpectraSolver, AgreesOnABody) {
  expect_agreement(unbridged(body()), 150);
}

TEST(SpectraSolver, AgreesOnASurfaceWithBoundary) {
  Surface sheet = testing::square_grid(40);
  sheet.positions = testing::bent(sheet.positions);
  expect_agreement(unbridged(sheet), 80);
}

TEST(SpectraSolver, AgreesOnManyComponents) {
  std::vector<Surface> parts(9, make_icosphere(2));
  parts.push_back(make_torus(30, 15, 1, 0.4));
  parts.push_back(body());
  expect_agreement(unbridged(testing::side_by_side(parts, 4)), 140);
}

TEST(SpectraSolver, SphereHasItsMultiplicities) {
  const auto basis = solve_eigenbasis(unbridged(make_icosphere(4)), 100, {}, EigenSolver::kSpectra);
  ASSERT_TRUE(basis) << basis.error().message;
  Eigen::Index j = 0;
  for (int l = 0; l < 10; ++l) {
    for (int copy = 0; copy < 2 * l + 1; ++copy, ++j)
      EXPECT_NEAR(basis->eigenvalues[j], l * (l + 1), 0.05 * l * (l + 1)) << "l = " << l << ", copy " << copy;
  }
}

TEST(SpectraSolver, FewerPairsThanComponents) {
  const Laplacian laplacian = unbridged(testing::side_by_side(std::vector<Surface>(5, make_icosphere(1)), 3));
  const auto basis = solve_eigenbasis(laplacian, 3, {}, EigenSolver::kSpectra);
  ASSERT_TRUE(basis) << basis.error().message;
  EXPECT_EQ(basis->eigenvalues.cwiseAbs().maxCoeff(), 0);
  EXPECT_LE(testing::orthonormality_defect(basis->Phi, laplacian.mass), 1e-12);
}

TEST(SpectraSolver, RefusesLargeSurfaces) {
  const Laplacian laplacian = unbridged(make_torus(301, 100, 1, 0.4));
  ASSERT_GT(laplacian.mass.size(), kSpectraMaxVertices);
  const auto basis = solve_eigenbasis(laplacian, 10, {}, EigenSolver::kSpectra);
  ASSERT_FALSE(basis);
  EXPECT_EQ(basis.error().code, ErrorCode::kTooLarge);
}

TEST(SpectraSolver, StopsWhenAskedTo) {
  const Laplacian laplacian = unbridged(make_torus(40, 20, 1.0, 0.4));
  for (const int allowed : {0, 1, 40}) {
    int calls = 0;
    const auto more = [&](double, std::string_view) { return calls++ < allowed; };
    const auto basis = solve_eigenbasis(laplacian, 60, more, EigenSolver::kSpectra);
    ASSERT_FALSE(basis);
    EXPECT_EQ(basis.error().code, ErrorCode::kCancelled);
    EXPECT_EQ(calls, allowed + 1);
  }
}

TEST(SpectraSolver, SameInputSameBits) {
  const Laplacian laplacian = unbridged(make_torus(40, 20, 1.0, 0.4));
  const auto a = solve_eigenbasis(laplacian, 60, {}, EigenSolver::kSpectra);
  const auto b = solve_eigenbasis(laplacian, 60, {}, EigenSolver::kSpectra);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->Phi, b->Phi);
}

TEST(BasisOptions, NamesAreParsed) {
  for (const std::string_view name : kBasisNames.names) EXPECT_EQ(name_of(basis_from_name(name).value()), name);
  EXPECT_EQ(basis_from_name("fourier").error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(kSolverNames.find("spectra"), EigenSolver::kSpectra);
  EXPECT_EQ(kPointsOperatorNames.find("pb-mhb"), PointsOperator::kPbMhb);
}

}  // namespace
}  // namespace eigencast
