// SPDX-License-Identifier: MIT
#include "common/spectral/basis.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/spectral/augment.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/kg_error.h"
#include "common/spectral/prefix_fit.h"
#include "support.h"

namespace eigencast {
namespace {

using testing::affine_image;
using testing::matrix_from;
using testing::orthonormality_defect;
using testing::round_trip;
using testing::worst_error;

Basis basis_of(const Surface& surface, BasisKind kind, int rank) {
  const auto laplacian = build_laplacian(surface);
  EXPECT_TRUE(laplacian);
  auto basis = build_basis(surface, *laplacian, {kind, rank});
  EXPECT_TRUE(basis) << basis.error().message;
  return std::move(*basis);
}

Surface heart() {
  return (*builtin_clip("heart"))->rest();
}

Surface quantised(Surface surface, double grid) {
  for (Vec3& p : surface.positions) {
    for (double& x : p) x = grid * std::round(x / grid);
  }
  return surface;
}

void expect_exact(const Basis& basis, const Surface& surface) {
  EXPECT_LE(orthonormality_defect(basis.Psi, basis.mass), 1e-10);
  EXPECT_LE(worst_error(surface.positions, round_trip(basis, surface.positions)), 1e-12);
  const std::vector<Vec3> image = affine_image(surface.positions);
  EXPECT_LE(worst_error(image, round_trip(basis, image)), 1e-12);
}

TEST(AugmentedBasis, ReproducesRestAndEveryAffineImage) {
  for (const Surface& surface : {make_torus(60, 30, 1.0, 0.4), make_icosphere(3), make_box(6, 8, 20, {1, 1, 3})}) {
    const Basis basis = basis_of(surface, BasisKind::kAugmented, 60);
    EXPECT_EQ(basis.Psi.cols(), 60);
    EXPECT_TRUE(basis.certified);
    expect_exact(basis, surface);
  }
}

TEST(HarmonicBasis, DoesNotReproduceRest) {
  const Surface surface = make_box(8, 8, 40, {1, 1, 5});
  const Basis basis = basis_of(surface, BasisKind::kHarmonic, 60);
  EXPECT_EQ(basis.Psi.cols(), 60);
  EXPECT_LE(orthonormality_defect(basis.Psi, basis.mass), 1e-10);
  EXPECT_GT(worst_error(surface.positions, round_trip(basis, surface.positions)), 1e-4);
}

TEST(AugmentedBasis, RestLiesInTheFirstFourColumns) {
  const Surface surface = make_torus(60, 30, 1.0, 0.4);
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 104);
  const Eigen::MatrixXd C = coefficients_from_positions(basis, affine_image(surface.positions));
  EXPECT_LE(C.bottomRows(100).cwiseAbs().maxCoeff(), 1e-11 * C.cwiseAbs().maxCoeff());
  EXPECT_LE((basis.Psi.col(0).array().abs() - 1 / std::sqrt(basis.area)).abs().maxCoeff(), 1e-12);
  const std::vector<Vec3> pose = testing::bent(surface.positions);
  const Eigen::MatrixXd D = coefficients_from_positions(basis, pose);
  double before = 1;
  for (const Eigen::Index prefix : {4, 14, 54, 104}) {
    Basis cut = basis;
    cut.Psi = basis.Psi.leftCols(prefix);
    const double error = worst_error(pose, positions_from_coefficients(cut, D.topRows(prefix)));
    EXPECT_LT(error, before);
    before = error;
  }
}

TEST(AugmentedBasis, BeatsHarmonicOnABend) {
  const Surface surface = make_box(8, 8, 40, {1, 1, 5});
  const std::vector<Vec3> pose = testing::bent(surface.positions);
  KgError harmonic;
  harmonic.add_frame(pose, round_trip(basis_of(surface, BasisKind::kHarmonic, 60), pose));
  KgError augmented;
  augmented.add_frame(pose, round_trip(basis_of(surface, BasisKind::kAugmented, 60), pose));
  EXPECT_LT(augmented.percent(), harmonic.percent() / 2);
}

/// On smooth shapes products of harmonics and coordinates almost depend on others; the normalised remainder is noise of
/// the mesh. Every column must be about as smooth as the harmonics that it replaces.
TEST(AugmentedBasis, KeepsNoAmplifiedNoiseOnSmoothShapes) {
  for (const Surface& surface : {make_icosphere(3), make_torus(50, 25, 1.0, 0.4), heart()}) {
    const auto laplacian = build_laplacian(surface);
    ASSERT_TRUE(laplacian);
    const auto basis = build_basis(surface, *laplacian, {BasisKind::kAugmented, 100});
    ASSERT_TRUE(basis);
    ASSERT_EQ(basis->Psi.cols(), 100);
    expect_exact(*basis, surface);
    const auto harmonics = solve_eigenbasis(*laplacian, 100);
    ASSERT_TRUE(harmonics);
    const Eigen::VectorXd energy = (basis->Psi.transpose() * (laplacian->L * basis->Psi)).diagonal();
    EXPECT_LT(energy.maxCoeff(), 1.5 * harmonics->eigenvalues[99]);
  }
}

TEST(AugmentedBasis, SurvivesARestPoseOnACoarseGrid) {
  for (const double grid : {0.02, 0.1}) {  // edges are 0.07 to 0.1 long: many faces lose their area
    const Surface surface = quantised(make_icosphere(4), grid);
    const auto laplacian = build_laplacian(surface);
    ASSERT_TRUE(laplacian);
    const auto basis = build_basis(surface, *laplacian, {BasisKind::kAugmented, 100});
    ASSERT_TRUE(basis) << basis.error().message;
    EXPECT_EQ(basis->Psi.cols(), 100);
    EXPECT_TRUE(basis->Psi.allFinite());
    expect_exact(*basis, surface);
  }
}

TEST(AugmentedBasis, FlatSheetsSaveOneColumn) {
  Surface sheet;
  constexpr std::uint32_t kSide = 20;
  for (std::uint32_t i = 0; i < kSide * kSide; ++i) {  // tilted, so that no coordinate is exactly constant
    const double u = i % kSide;
    const double v = i / kSide;
    sheet.positions.push_back({u, v, 0.3 * u + 0.1 * v + 7});
  }
  for (std::uint32_t v = 0; v + 1 < kSide; ++v) {
    for (std::uint32_t u = 0; u + 1 < kSide; ++u) {
      const std::uint32_t a = v * kSide + u;
      sheet.faces.push_back({a, a + 1, a + kSide});
      sheet.faces.push_back({a + 1, a + kSide + 1, a + kSide});
    }
  }
  const Basis basis = basis_of(sheet, BasisKind::kAugmented, 50);
  EXPECT_EQ(basis.Psi.cols(), 50);
  EXPECT_TRUE(basis.Psi.allFinite());
  expect_exact(basis, sheet);
}

TEST(AugmentedBasis, PointCloudsAndComponentsAreExactToo) {
  Surface cloud = make_torus(60, 30, 1.0, 0.4);
  cloud.faces.clear();
  expect_exact(basis_of(cloud, BasisKind::kAugmented, 60), cloud);
  const Surface pieces = testing::side_by_side({make_icosphere(3), make_torus(30, 15, 1.0, 0.4), make_icosphere(2)}, 3);
  expect_exact(basis_of(pieces, BasisKind::kAugmented, 60), pieces);
}

/// Forty-one balls that touch and overlap, some vertices twice.
Surface many_pieces() {
  std::mt19937 generator(11);
  Surface all;
  const Surface ball = make_icosphere(2);
  for (int piece = 0; piece < 41; ++piece) {
    const Vec3 centre{3 * testing::uniform(generator), 3 * testing::uniform(generator),
                      3 * testing::uniform(generator)};
    const double radius = 0.15 + 0.3 * testing::uniform(generator);
    const auto first = static_cast<std::uint32_t>(all.positions.size());
    for (const Vec3& p : ball.positions) {
      all.positions.push_back({centre[0] + radius * p[0], centre[1] + radius * p[1], centre[2] + radius * p[2]});
    }
    for (const Face& f : ball.faces) all.faces.push_back({f[0] + first, f[1] + first, f[2] + first});
    all.positions.push_back(all.positions[first + 7]);
    all.faces.push_back({first + 161 + 1, first, first + 1});
  }
  return all;
}

/// Each piece moves by itself.
std::vector<Vec3> scattered(const Surface& pieces) {
  std::mt19937 generator(13);
  std::vector<Vec3> pose = pieces.positions;
  for (std::size_t first = 0; first < pose.size(); first += 163) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double step = 0.2 * testing::uniform(generator);
      for (std::size_t i = first; i < first + 163; ++i) pose[i][axis] += step;
    }
  }
  return pose;
}

// Without faces the balls of overlapping points are unknown: worse than the mesh, but a basis still.
TEST(AugmentedBasis, ManyPiecesAsPointsKeepABasis) {
  Surface pieces = many_pieces();
  const std::vector<Vec3> pose = scattered(pieces);
  const auto percent = [&] {
    const auto laplacian = build_laplacian(pieces);
    EXPECT_TRUE(laplacian);
    const auto basis = build_basis(pieces, *laplacian, {BasisKind::kAugmented, 200});
    EXPECT_TRUE(basis && basis->certified);
    KgError error;
    error.add_frame(pose, testing::round_trip(*basis, pose));
    return error.percent();
  };
  const double mesh = percent();
  pieces.faces.clear();
  EXPECT_LE(mesh, 1);
  EXPECT_LE(percent(), 3);
}

TEST(AugmentedBasis, StaysExactFarFromTheOrigin) {
  Surface surface = make_torus(40, 20, 1.0, 0.4);
  for (Vec3& p : surface.positions) p[0] += 1e5;
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 60);
  EXPECT_LE(worst_error(surface.positions, round_trip(basis, surface.positions)), 1e-9);
}

TEST(Basis, RankIsLoweredToWhatTheVerticesAllow) {
  const Surface surface = make_icosphere(1);  // 42 vertices
  EXPECT_EQ(basis_of(surface, BasisKind::kHarmonic, 200).Psi.cols(), 20);
  EXPECT_EQ(basis_of(surface, BasisKind::kAugmented, 200).Psi.cols(), 20);
  const Surface tetrahedron{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}}};
  const Basis least = basis_of(tetrahedron, BasisKind::kAugmented, 200);
  EXPECT_EQ(least.Psi.cols(), 4);
  expect_exact(least, tetrahedron);
}

TEST(Basis, EveryRankFromOneUpWorks) {
  const Surface surface = make_icosphere(2);
  for (int rank = 1; rank <= 45; ++rank) {
    for (const BasisKind kind : {BasisKind::kHarmonic, BasisKind::kAugmented}) {
      const Basis basis = basis_of(surface, kind, rank);
      EXPECT_EQ(basis.Psi.cols(), rank);
      EXPECT_LE(orthonormality_defect(basis.Psi, basis.mass), 1e-10) << rank;
    }
  }
}

TEST(Basis, RigidMotionOfAPoseTurnsItsCoefficients) {
  const Surface surface = make_torus(40, 20, 1.0, 0.4);
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 60);
  const std::vector<Vec3> pose = testing::bent(surface.positions);
  const double angle = 0.7;
  std::vector<Vec3> moved;
  for (const Vec3& p : pose) {
    moved.push_back({std::cos(angle) * p[0] - std::sin(angle) * p[1] + 3,
                     std::sin(angle) * p[0] + std::cos(angle) * p[1] - 1, p[2] + 2});
  }
  Eigen::Matrix3d R;
  R << std::cos(angle), -std::sin(angle), 0, std::sin(angle), std::cos(angle), 0, 0, 0, 1;
  const Eigen::VectorXd constant = basis.Psi.transpose() * basis.mass;
  const Eigen::MatrixXd expected =
      coefficients_from_positions(basis, pose) * R.transpose() + constant * Eigen::RowVector3d(3, -1, 2);
  EXPECT_LE((coefficients_from_positions(basis, moved) - expected).cwiseAbs().maxCoeff(),
            1e-12 * expected.cwiseAbs().maxCoeff());
}

TEST(Basis, ScaleChangesNoError) {
  Surface surface = make_torus(40, 20, 1.0, 0.4);
  KgError one;
  one.add_frame(testing::bent(surface.positions),
                round_trip(basis_of(surface, BasisKind::kAugmented, 40), testing::bent(surface.positions)));
  const std::vector<Vec3> pose = testing::scaled(testing::bent(surface.positions), 1000);
  surface.positions = testing::scaled(surface.positions, 1000);
  KgError thousand;
  thousand.add_frame(pose, round_trip(basis_of(surface, BasisKind::kAugmented, 40), pose));
  EXPECT_GT(one.percent(), 1e-3);
  EXPECT_NEAR(one.percent(), thousand.percent(), 1e-6 * one.percent());
}

/// One step for all coefficients gives the area-weighted error that Parseval promises: eps^2 = 3 r step^2 / (12 A).
TEST(Basis, QuantisingCostsWhatParsevalSays) {
  const Surface surface = make_box(8, 8, 40, {1, 1, 5});
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 100);
  const auto r = static_cast<double>(basis.Psi.cols());
  const double wanted = 1e-4 * bounding_box(surface.positions).diagonal();
  const double step = 2 * wanted * std::sqrt(basis.area / r);
  std::mt19937 generator(1);
  Eigen::MatrixXd C = coefficients_from_positions(basis, surface.positions);
  double squared = 0;
  constexpr int kPoses = 20;
  for (int pose = 0; pose < kPoses; ++pose) {
    Eigen::MatrixXd moved = C;
    for (double& c : moved.reshaped()) c += 100 * step * testing::uniform(generator);
    const Eigen::MatrixXd rounded = (moved / step).array().round() * step;
    const Eigen::MatrixXd error = matrix_from(positions_from_coefficients(basis, rounded)) -
                                  matrix_from(positions_from_coefficients(basis, moved));
    squared += basis.mass.dot(error.rowwise().squaredNorm()) / basis.area;
  }
  EXPECT_NEAR(std::sqrt(squared / kPoses), wanted, 0.1 * wanted);
}

TEST(Basis, StopsWhenAskedTo) {
  const Surface surface = make_torus(60, 30, 1.0, 0.4);
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(laplacian);
  std::string last;
  const auto basis = build_basis(surface, *laplacian, {BasisKind::kAugmented, 60}, [&](double, std::string_view stage) {
    last = stage;
    return stage != "augmenting";
  });
  ASSERT_FALSE(basis);
  EXPECT_EQ(basis.error().code, ErrorCode::kCancelled);
  EXPECT_EQ(last, "augmenting");
}

TEST(Basis, RefusesTheLaplacianOfAnotherSurface) {
  const auto laplacian = build_laplacian(make_icosphere(1));
  ASSERT_TRUE(laplacian);
  const auto basis = build_basis(make_icosphere(2), *laplacian, {});
  ASSERT_FALSE(basis);
  EXPECT_EQ(basis.error().code, ErrorCode::kInvalidArgument);
  EXPECT_FALSE(build_basis(make_icosphere(1), *laplacian, {BasisKind::kHarmonic, 0}));
}

// A torus and the heart are so smooth that products with their coordinates nearly depend on harmonics.
TEST(AugmentedBasis, CoarserSurfacePredictsTheHarmonicsNeeded) {
  constexpr int kRank = 60, kProducts = kRank / 10;
  for (const Surface& surface : {make_heart(30), make_torus(140, 60, 1.0, 0.4)}) {
    const auto laplacian = build_laplacian(surface);
    ASSERT_TRUE(laplacian);
    const int predicted = harmonics_on_coarser(surface.positions, *laplacian, kProducts, kRank);
    ASSERT_GE(predicted, kRank - 3 * kProducts);
    const auto columns_with = [&](int m) {
      const auto eigenbasis = solve_eigenbasis(*laplacian, m);
      Candidates candidates = candidates_from(surface.positions, laplacian->mass);
      candidates.harmonics = laplacian->mass.cwiseSqrt().asDiagonal() * eigenbasis->Phi;
      return Augmentation(candidates, kProducts).take(kProducts, kRank).cols();
    };
    EXPECT_EQ(columns_with(predicted), kRank);
    EXPECT_LT(columns_with(predicted - 3), kRank) << "predicted more than needed: " << predicted;
  }
  const auto small = build_laplacian(make_icosphere(2));
  EXPECT_EQ(harmonics_on_coarser(make_icosphere(2).positions, *small, 2, 20), 0);
}

/// Values at some vertices.
Eigen::MatrixXd rows_of(const Eigen::MatrixXd& Psi, const std::vector<std::uint32_t>& vertices) {
  Eigen::MatrixXd rows(static_cast<Eigen::Index>(vertices.size()), Psi.cols());
  for (std::size_t i = 0; i < vertices.size(); ++i) rows.row(static_cast<Eigen::Index>(i)) = Psi.row(vertices[i]);
  return rows;
}

TEST(BasisTrial, OffersAreTheBasesThatAreBuilt) {
  const Surface surface = make_torus(50, 25, 1.0, 0.4);
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(laplacian);
  const std::vector<std::uint32_t> vertices{0, 7, 400, 1249};
  for (const BasisKind kind : {BasisKind::kAugmented, BasisKind::kHarmonic}) {
    for (const std::size_t taken : {0u, 1u}) {
      OfferedBasis chosen;
      const BasisTrial trial{vertices, [&](std::span<const OfferedBasis> offers) -> Result<BasisShape> {
                               EXPECT_EQ(offers.size(), kind == BasisKind::kAugmented ? 2u : 1u);
                               chosen = offers[std::min(taken, offers.size() - 1)];
                               return BasisShape{120, chosen.products};
                             }};
      const auto basis = build_basis(surface, *laplacian, {kind, 150}, {}, &trial);
      ASSERT_TRUE(basis) << basis.error().message;
      ASSERT_EQ(basis->Psi.cols(), 120);
      ASSERT_EQ(chosen.rows.cols(), 150);
      EXPECT_LT((rows_of(basis->Psi, vertices) - chosen.rows.leftCols(120)).cwiseAbs().maxCoeff(), 1e-4);
      EXPECT_LT(orthonormality_defect(basis->Psi, basis->mass), 1e-9);
    }
  }
}

TEST(BasisTrial, ItsErrorEndsTheBuild) {
  const Surface surface = make_icosphere(3);
  const auto laplacian = build_laplacian(surface);
  const BasisTrial trial{
      {0}, [](std::span<const OfferedBasis>) -> Result<BasisShape> { return fail(ErrorCode::kCancelled, "stopped"); }};
  for (const BasisKind kind : {BasisKind::kAugmented, BasisKind::kHarmonic}) {
    const auto basis = build_basis(surface, *laplacian, {kind, 60}, {}, &trial);
    ASSERT_FALSE(basis);
    EXPECT_EQ(basis.error().code, ErrorCode::kCancelled);
  }
}

// Every prefix of the fit is the least-squares fit of that many columns, and its error that of the vertices.
TEST(PrefixFit, PrefixesAreLeastSquaresFits) {
  const Surface surface = make_box(6, 6, 20, {1, 1, 4});
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 60);
  const std::vector<Vec3> pose = testing::bent(surface.positions);
  const Eigen::MatrixXd X = matrix_from(pose);
  const PrefixFit fit(basis.Psi, basis.mass, X, static_cast<double>(X.rows()));
  const Eigen::VectorXd weights = basis.mass.cwiseSqrt();
  double before = HUGE_VAL;
  for (const int r : {1, 4, 17, 60}) {
    const Eigen::MatrixXd C = fit.coefficients(r), left = X - basis.Psi.leftCols(r) * C;
    EXPECT_LT((basis.Psi.leftCols(r).transpose() * weights.asDiagonal() * left).cwiseAbs().maxCoeff(), 1e-7);
    const double squared = left.squaredNorm() / static_cast<double>(X.rows());
    EXPECT_NEAR(fit.squared_error(C), squared, 1e-9 + 1e-6 * squared);
    EXPECT_LE(squared, before);
    before = squared;
  }
}

TEST(PrefixFit, SomeVerticesEstimateTheErrorOfAll) {
  const Surface surface = make_torus(80, 40, 1.0, 0.4);
  const Basis basis = basis_of(surface, BasisKind::kAugmented, 100);
  const Eigen::MatrixXd X = matrix_from(testing::bent(surface.positions));
  std::vector<std::uint32_t> some;
  for (std::uint32_t i = 0; i < surface.vertex_count(); i += 3) some.push_back(i);
  const auto n = static_cast<double>(X.rows());
  const PrefixFit all(basis.Psi, basis.mass, X, n);
  const PrefixFit few(rows_of(basis.Psi, some), rows_of(basis.mass, some).col(0), rows_of(X, some), n);
  for (const int r : {10, 40, 100}) {
    const double truth = all.squared_error(all.coefficients(r));
    EXPECT_NEAR(few.squared_error(few.coefficients(r)), truth, 0.15 * truth + 1e-12) << r;
  }
}

// Columns that none of the vertices has anything of leave the others alone.
TEST(PrefixFit, EmptyColumnsTakeNothing) {
  const Surface surface = make_icosphere(3);
  Basis basis = basis_of(surface, BasisKind::kAugmented, 20);
  const Eigen::MatrixXd X = matrix_from(testing::bent(surface.positions));
  const auto n = static_cast<double>(X.rows());
  basis.Psi.col(7).setZero();
  const PrefixFit fit(basis.Psi, basis.mass, X, n);
  const Eigen::MatrixXd C = fit.coefficients(20);
  EXPECT_TRUE(C.allFinite());
  EXPECT_LT(C.row(7).cwiseAbs().maxCoeff(), 1e-3);
}

}  // namespace
}  // namespace eigencast
