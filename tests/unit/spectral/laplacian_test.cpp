// SPDX-License-Identifier: MIT
#include "common/spectral/laplacian.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <numbers>

#include "common/spectral/point_operators.h"
#include "common/spectral/symmetric_form.h"
#include "common/spectral/tangent_derivatives.h"
#include "support.h"

namespace eigencast {
namespace {

using testing::matrix_from;

double true_area(const Surface& surface) {
  double area = 0;
  for (const Face& f : surface.faces) {
    const auto at = [&](std::size_t i) {
      const Vec3& p = surface.positions[f[i]];
      return Eigen::Vector3d(p[0], p[1], p[2]);
    };
    area += 0.5 * (at(1) - at(0)).cross(at(2) - at(0)).norm();
  }
  return area;
}

/// Invariants of every operator, however bad its surface.
void expect_usable(const Laplacian& laplacian, std::size_t n) {
  ASSERT_EQ(laplacian.L.rows(), static_cast<Eigen::Index>(n));
  ASSERT_EQ(laplacian.mass.size(), static_cast<Eigen::Index>(n));
  EXPECT_TRUE(laplacian.mass.allFinite());
  EXPECT_GT(laplacian.mass.minCoeff(), 0);
  EXPECT_NEAR(laplacian.mass.sum(), laplacian.area, 1e-12 * laplacian.area);
  const double scale = laplacian.L.diagonal().cwiseAbs().maxCoeff();
  const Eigen::SparseMatrix<double> skew = laplacian.L - Eigen::SparseMatrix<double>(laplacian.L.transpose());
  EXPECT_LE(skew.norm(), 1e-13 * scale * static_cast<double>(n));
  EXPECT_LE((laplacian.L * Eigen::VectorXd::Ones(laplacian.L.cols())).cwiseAbs().maxCoeff(), 1e-11 * scale);
}

/// Dense spectrum of M^{-1/2} L M^{-1/2}, for small surfaces.
Eigen::VectorXd spectrum(const Laplacian& laplacian) {
  const Eigen::VectorXd scale = laplacian.mass.cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd S = scale.asDiagonal() * Eigen::MatrixXd(laplacian.L) * scale.asDiagonal();
  return dense_eigen(S).values;
}

TEST(Laplacian, MassSumsToAreaAndKernelHoldsConstants) {
  for (const Surface& surface : {make_icosphere(4), make_torus(60, 30, 1.0, 0.4), make_box(5, 7, 9, {1, 2, 3})}) {
    const auto laplacian = build_laplacian(surface);
    ASSERT_TRUE(laplacian);
    expect_usable(*laplacian, surface.vertex_count());
    EXPECT_NEAR(laplacian->area, true_area(surface), 1e-12 * laplacian->area);
    EXPECT_EQ(laplacian->components, 1);
    EXPECT_EQ(laplacian->bridges, 0);
  }
}

TEST(Laplacian, CoordinatesHaveDirichletEnergyOfTwiceTheArea) {
  const Surface surface = make_torus(60, 30, 1.0, 0.4);
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(laplacian);
  const Eigen::MatrixXd X = matrix_from(surface.positions);
  const double energy = (X.transpose() * (laplacian->L * X)).trace();
  EXPECT_NEAR(energy, 2 * laplacian->area, 1e-11 * energy);
}

TEST(Laplacian, ScaleChangesMassButNotWeights) {
  Surface surface = make_icosphere(3);
  const auto small = build_laplacian(surface);
  surface.positions = testing::scaled(surface.positions, 1e6);
  const auto large = build_laplacian(surface);
  ASSERT_TRUE(small && large);
  EXPECT_LE((small->L - large->L).norm(), 1e-9 * small->L.norm());
  EXPECT_NEAR(large->area, 1e12 * small->area, 1e-9 * large->area);
}

TEST(Laplacian, BridgesLeaveOneZeroEigenvalue) {
  const Surface surface = testing::side_by_side({make_icosphere(1), make_torus(8, 6, 1.0, 0.3), make_icosphere(0)}, 4);
  const auto joined = build_laplacian(surface);
  ASSERT_TRUE(joined);
  expect_usable(*joined, surface.vertex_count());
  EXPECT_EQ(joined->components, 3);
  EXPECT_GE(joined->bridges, 2);
  const Eigen::VectorXd lambda = spectrum(*joined);
  EXPECT_NEAR(lambda[0], 0, 1e-10);
  EXPECT_GT(lambda[1], 1e-3);

  const auto apart = build_laplacian(surface, {.bridge = false});
  ASSERT_TRUE(apart);
  EXPECT_EQ(apart->components, 3);
  EXPECT_EQ(apart->bridges, 0);
  const Eigen::VectorXd kernel = spectrum(*apart).head(4);
  EXPECT_NEAR(kernel[2], 0, 1e-10);
  EXPECT_GT(kernel[3], 1e-3);
}

TEST(Laplacian, ManyPiecesOfOneTriangleBecomeOne) {
  Surface soup;
  std::mt19937 generator(5);
  for (std::uint32_t t = 0; t < 60; ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      soup.positions.push_back({testing::uniform(generator), testing::uniform(generator), testing::uniform(generator)});
    }
    soup.faces.push_back({3 * t, 3 * t + 1, 3 * t + 2});
  }
  const auto laplacian = build_laplacian(soup);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, soup.vertex_count());
  EXPECT_EQ(laplacian->components, 60);
  const Eigen::VectorXd lambda = spectrum(*laplacian);
  EXPECT_GT(lambda[1], 1e-9 * lambda[lambda.size() - 1]);
}

TEST(Laplacian, UnreferencedVerticesGetMassAndABridge) {
  Surface surface = make_icosphere(2);
  const auto median_before = build_laplacian(surface);
  surface.positions.push_back({0, 0, 3});
  surface.positions.push_back({0, 3, 0});
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(median_before && laplacian);
  expect_usable(*laplacian, surface.vertex_count());
  EXPECT_EQ(laplacian->components, 3);
  const Eigen::Index n = laplacian->mass.size();
  EXPECT_LT(laplacian->mass[n - 1], 2e-3 * laplacian->mass.head(n - 2).maxCoeff());
  EXPECT_GT(spectrum(*laplacian)[1], 0.1);
}

TEST(Laplacian, DegenerateFacesLeaveItFiniteAndSemidefinite) {
  Surface surface = make_icosphere(2);
  const std::uint32_t copy = static_cast<std::uint32_t>(surface.positions.size());
  surface.positions.push_back(surface.positions[0]);  // two corners at one point
  surface.faces.push_back({0, copy, 1});
  surface.faces.push_back({2, 2, 3});  // a corner twice
  surface.positions.push_back({0.5 * (surface.positions[4][0] + surface.positions[5][0]),
                               0.5 * (surface.positions[4][1] + surface.positions[5][1]),
                               0.5 * (surface.positions[4][2] + surface.positions[5][2])});
  surface.faces.push_back({4, 5, copy + 1});  // on a line
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, surface.vertex_count());
  const Eigen::VectorXd lambda = spectrum(*laplacian);
  EXPECT_TRUE(lambda.allFinite());
  EXPECT_GE(lambda[0], -1e-12 * lambda[lambda.size() - 1]);
}

TEST(Laplacian, AcceptsNonManifoldEdgesAndTurnedFaces) {
  Surface surface = make_box(3, 3, 3, {1, 1, 1});
  surface.positions.push_back({0.5, 0.5, 4});
  surface.faces.push_back(
      {surface.faces[0][0], surface.faces[0][1], static_cast<std::uint32_t>(surface.positions.size() - 1)});
  for (std::size_t f = 0; f < surface.faces.size(); f += 3) std::swap(surface.faces[f][0], surface.faces[f][1]);
  const auto laplacian = build_laplacian(surface);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, surface.vertex_count());
  EXPECT_GE(spectrum(*laplacian)[0], -1e-10);
}

/// Takes a weight matrix without its diagonal.
double largest_entry_off_the_diagonal(const Eigen::SparseMatrix<double>& L) {
  double largest = -std::numeric_limits<double>::infinity();
  for (int k = 0; k < L.outerSize(); ++k) {
    for (Eigen::SparseMatrix<double>::InnerIterator it(L, k); it; ++it) {
      if (it.row() != it.col()) largest = std::max(largest, it.value());
    }
  }
  return largest;
}

TEST(TuftedCover, DelaunayMeshIsCoveredTwice) {
  const Surface sphere = make_icosphere(3);
  const auto plain = build_laplacian(sphere), tufted = build_laplacian(sphere, {.delaunay = true});
  ASSERT_TRUE(plain && tufted);
  EXPECT_FALSE(plain->flips.has_value());
  EXPECT_EQ(tufted->flips, 0u);
  EXPECT_LE((plain->L - tufted->L).norm(), 1e-12 * plain->L.norm());
  EXPECT_LE((plain->mass - tufted->mass).norm(), 1e-12 * plain->mass.norm());
}

TEST(TuftedCover, FlipsRemoveNegativeWeightsAndKeepArea) {
  Surface torus = make_torus(80, 12, 1.0, 0.4);
  for (Vec3& p : torus.positions) p[2] *= 6;  // long and thin, many angles obtuse
  const auto plain = build_laplacian(torus), flipped = build_laplacian(torus, {.delaunay = true});
  ASSERT_TRUE(plain && flipped);
  expect_usable(*flipped, torus.vertex_count());
  EXPECT_GT(*flipped->flips, 100u);
  EXPECT_GT(largest_entry_off_the_diagonal(plain->L), 0.1);
  EXPECT_LE(largest_entry_off_the_diagonal(flipped->L), 1e-8);
  EXPECT_NEAR(flipped->area, plain->area, 1e-9 * plain->area);
}

// Three pages of a book, sharing the spine.
TEST(TuftedCover, IsUsedWhereAnEdgeHasThreeFaces) {
  Surface book;
  constexpr std::uint32_t kLines = 12, kColumns = 5;
  for (std::uint32_t line = 0; line < kLines; ++line) book.positions.push_back({0, 0, 0.3 * line});
  for (int page = 0; page < 3; ++page) {
    const auto first = static_cast<std::uint32_t>(book.positions.size());
    const double angle = 2.1 * page;
    for (std::uint32_t column = 1; column < kColumns; ++column) {
      for (std::uint32_t line = 0; line < kLines; ++line)
        book.positions.push_back({column * std::cos(angle), column * std::sin(angle), 0.3 * line});
    }
    const auto at = [&](std::uint32_t column, std::uint32_t line) {
      return column == 0 ? line : first + (column - 1) * kLines + line;
    };
    for (std::uint32_t column = 0; column + 1 < kColumns; ++column) {
      for (std::uint32_t line = 0; line + 1 < kLines; ++line) {
        book.faces.push_back({at(column, line), at(column + 1, line), at(column + 1, line + 1)});
        book.faces.push_back({at(column, line), at(column + 1, line + 1), at(column, line + 1)});
      }
    }
  }
  Surface turned = book;
  for (std::size_t f = 0; f < turned.faces.size(); f += 3) std::swap(turned.faces[f][0], turned.faces[f][2]);
  const auto laplacian = build_laplacian(book), other = build_laplacian(turned);
  ASSERT_TRUE(laplacian && other);
  ASSERT_TRUE(laplacian->flips.has_value());
  expect_usable(*laplacian, book.vertex_count());
  EXPECT_NEAR(laplacian->area, true_area(book), 1e-9 * laplacian->area);
  EXPECT_LE(largest_entry_off_the_diagonal(laplacian->L), 1e-8);
  EXPECT_GE(spectrum(*laplacian).minCoeff(), -1e-9);
  EXPECT_LE((laplacian->L - other->L).norm(), 1e-6 * laplacian->L.norm());
}

TEST(Laplacian, RefusesSurfacesWithoutArea) {
  const Surface collinear{{{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {3, 3, 3}, {5, 5, 5}}, {{0, 1, 2}, {1, 2, 3}, {2, 3, 4}}};
  for (Surface surface :
       {collinear, Surface{collinear.positions, {}}, Surface{std::vector<Vec3>(50, Vec3{1, 2, 3}), {}},
        Surface{std::vector<Vec3>(4, Vec3{1, 2, 3}), {{0, 1, 2}, {1, 2, 3}}}}) {
    const auto laplacian = build_laplacian(surface);
    ASSERT_FALSE(laplacian);
    EXPECT_EQ(laplacian.error().code, ErrorCode::kNumerical) << laplacian.error().message;
  }
}

TEST(Laplacian, RefusesInvalidSurfaces) {
  Surface surface = make_icosphere(1);
  surface.positions[7][1] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(build_laplacian(surface));
  surface = make_icosphere(1);
  surface.faces[3][1] = 1000;
  EXPECT_FALSE(build_laplacian(surface));
}

Surface fibonacci_cloud(int n) {
  Surface cloud;
  for (int i = 0; i < n; ++i) {
    const double z = 1 - (2.0 * i + 1) / n;
    const double angle = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double radius = std::sqrt(1 - z * z);
    cloud.positions.push_back({radius * std::cos(angle), radius * std::sin(angle), z});
  }
  return cloud;
}

Surface grid_cloud(int width, int height) {
  Surface cloud;
  for (int i = 0; i < width; ++i) {
    for (int j = 0; j < height; ++j) cloud.positions.push_back({double(i), double(j), 0});
  }
  return cloud;
}

TEST(PointLaplacian, CoversTheSphereOnce) {
  const Surface cloud = fibonacci_cloud(2000);
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  EXPECT_EQ(laplacian->components, 1);
  EXPECT_NEAR(laplacian->area, 4 * std::numbers::pi, 0.01 * laplacian->area);
  EXPECT_LT(static_cast<double>(laplacian->L.nonZeros()) / 2000, 9.5);
  const Eigen::MatrixXd X = matrix_from(cloud.positions);
  EXPECT_NEAR((X.transpose() * (laplacian->L * X)).trace(), 2 * laplacian->area, 1e-9 * laplacian->area);
}

TEST(PointLaplacian, CoincidentPointsShareMassAndStayConnected) {
  Surface cloud = fibonacci_cloud(400);
  for (int copy = 0; copy < 50; ++copy)
    cloud.positions.push_back(cloud.positions[7]);  // more than the neighbours that are tried
  for (std::size_t i = 0; i < 400; i += 5) cloud.positions.push_back(cloud.positions[i]);
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  EXPECT_NEAR(laplacian->area, 4 * std::numbers::pi, 0.05 * laplacian->area);
  EXPECT_GT(spectrum(*laplacian)[1], 1.0);
}

TEST(PointLaplacian, TightClustersAreBridged) {
  Surface cloud = fibonacci_cloud(400);
  std::mt19937 generator(3);
  for (int i = 0; i < 40; ++i) {
    const Vec3& at = cloud.positions[11];
    cloud.positions.push_back({at[0] + 1e-6 * testing::uniform(generator), at[1] + 1e-6 * testing::uniform(generator),
                               at[2] + 1e-6 * testing::uniform(generator)});
  }
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  const Eigen::VectorXd lambda = spectrum(*laplacian);
  EXPECT_GE(lambda[0], -1e-12 * lambda[lambda.size() - 1]);
  EXPECT_GT(lambda[1], 0.1);
}

TEST(PointLaplacian, AcceptsGridsWithOpenBorders) {
  const Surface cloud = grid_cloud(15, 15);
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  EXPECT_NEAR(laplacian->area, 14 * 14, 0.15 * 14 * 14);
  EXPECT_GT(spectrum(*laplacian)[1], 0.5 * std::pow(std::numbers::pi / 14, 2));
}

TEST(PointLaplacian, FourPointsSuffice) {
  const Surface cloud{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {}};
  const auto laplacian = build_laplacian(cloud);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, 4);
}

TEST(LocalDelaunay, GridCellsAreSquaresAndOpenCellsZero) {
  const Surface cloud = grid_cloud(12, 11);
  const LocalTriangles local = local_delaunay(cloud.positions);
  ASSERT_EQ(local.cell.size(), cloud.vertex_count());
  for (std::size_t i = 0; i < local.cell.size(); ++i) {
    const auto [x, y, z] = cloud.positions[i];
    const bool inner = x > 0 && x < 11 && y > 0 && y < 10;
    EXPECT_NEAR(local.cell[i], inner ? 1 : 0, 1e-12) << i;
  }
}

constexpr LaplacianOptions kPbMhb{.points = PointsOperator::kPbMhb};

// The formula by hand: unit cells, four neighbours at 1 and the next two at the root of 2.
TEST(PbMhb, GridWeightsAreTheHeatKernel) {
  const int size = 25;
  const auto laplacian = build_laplacian(grid_cloud(size, size), kPbMhb);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, size * size);
  const double h = (4 + 2 * std::sqrt(2)) / 6, t = h * h;
  const int middle = size * (size / 2) + size / 2;
  EXPECT_NEAR(laplacian->mass[middle], 1, 1e-12);
  for (const auto& [dx, dy] : {std::pair{1, 0}, {0, 2}, {3, -2}, {-4, 4}}) {
    const double weight = std::exp(-(dx * dx + dy * dy) / (4 * t)) / (4 * std::numbers::pi * t * t);
    EXPECT_NEAR(laplacian->L.coeff(middle, middle + size * dx + dy), -weight, 1e-12 * weight) << dx << " " << dy;
  }
  EXPECT_EQ(laplacian->L.coeff(middle, middle + 7 * size), 0);  // beyond 6.07 h
}

/// Mean distance to the six nearest points, by brute force.
double squared_spacing(const Surface& cloud) {
  const Eigen::MatrixXd X = matrix_from(cloud.positions);
  double sum = 0;
  int points = 0;
  for (Eigen::Index i = 0; i < X.rows(); i += 50, ++points) {
    Eigen::VectorXd distance = (X.rowwise() - X.row(i)).rowwise().norm();
    std::partial_sort(distance.begin(), distance.begin() + 7, distance.end());
    sum += distance.segment(1, 6).mean();
  }
  return std::pow(sum / points, 2);
}

TEST(PbMhb, SphereEigenvaluesMatchAfterBiasCorrection) {
  const Surface cloud = fibonacci_cloud(2500);
  const auto laplacian = build_laplacian(cloud, kPbMhb);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  EXPECT_EQ(laplacian->components, 1);
  EXPECT_NEAR(laplacian->area, 4 * std::numbers::pi, 0.01 * laplacian->area);
  EXPECT_GT(laplacian->L.nonZeros(), 100 * 2500);
  const auto basis = solve_eigenbasis(*laplacian, 36);
  ASSERT_TRUE(basis) << basis.error().message;
  EXPECT_TRUE(basis->certified);
  const double t = squared_spacing(cloud);
  for (int k = 1; k < 36; ++k) {
    const double l = std::floor(std::sqrt(k)), truth = l * (l + 1);
    EXPECT_NEAR(-std::log(1 - t * basis->eigenvalues[k]) / t, truth, 0.03 * truth) << k;
    EXPECT_LT(basis->eigenvalues[k], truth) << k;
  }
}

TEST(PbMhb, ScalesLikeALaplacian) {
  Surface cloud = fibonacci_cloud(500);
  const auto small = build_laplacian(cloud, kPbMhb);
  for (Vec3& p : cloud.positions) p = {1000 * p[0], 1000 * p[1], 1000 * p[2]};
  const auto large = build_laplacian(cloud, kPbMhb);
  ASSERT_TRUE(small && large);
  EXPECT_LE((small->L - large->L).norm(), 1e-9 * small->L.norm());
  EXPECT_LE((1e6 * small->mass - large->mass).norm(), 1e-9 * large->mass.norm());
}

// A dense cluster next to few points, many copies of one, and a border: rows are bounded and finite.
TEST(PbMhb, AcceptsClustersCopiesAndBorders) {
  Surface cloud = grid_cloud(20, 20);
  std::mt19937 generator(3);
  for (int i = 0; i < 220; ++i) {
    cloud.positions.push_back({5 + 1e-4 * testing::uniform(generator), 5 + 1e-4 * testing::uniform(generator), 0});
  }
  for (int copy = 0; copy < 150; ++copy) cloud.positions.push_back(cloud.positions[7]);
  cloud.positions.push_back({60, 60, 0});
  const auto laplacian = build_laplacian(cloud, kPbMhb);
  ASSERT_TRUE(laplacian);
  expect_usable(*laplacian, cloud.vertex_count());
  EXPECT_LE(laplacian->L.nonZeros(), Eigen::Index{2 * 192 + 1} * laplacian->L.rows());
  EXPECT_NEAR(laplacian->area, 20 * 20, 0.1 * 20 * 20);
  const Eigen::VectorXd lambda = spectrum(*laplacian);
  EXPECT_GE(lambda[0], -1e-12 * lambda[lambda.size() - 1]);
  EXPECT_GT(lambda[1], 1e-4);
}

TEST(PbMhb, RefusesCollinearPointsAndAcceptsFour) {
  Surface line;
  for (int i = 0; i < 50; ++i) line.positions.push_back({double(i), 2.0 * i, 0});
  EXPECT_FALSE(build_laplacian(line, kPbMhb));
  const auto four = build_laplacian({{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {}}, kPbMhb);
  ASSERT_TRUE(four);
  expect_usable(*four, 4);
}

TEST(TangentDerivatives, TangentsAreOrthonormalAndSlopesExact) {
  const Surface torus = make_torus(40, 20, 1, 0.4);
  std::vector<std::uint32_t> parents;
  for (std::uint32_t i = 0; i < torus.vertex_count(); ++i) parents.push_back(i == 0 ? 0 : i - 1);
  for (const std::vector<Face>& faces : {torus.faces, std::vector<Face>()}) {
    const TangentDerivatives derivatives = tangent_derivatives(torus.positions, faces, parents);
    Eigen::Vector3d before = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < torus.vertex_count(); ++i) {
      Eigen::Vector3d x = Eigen::Vector3d::Zero(), y = Eigen::Vector3d::Zero();
      double constant = 0;
      for (const auto& [j, along_x, along_y] : derivatives.of(i)) {
        const Vec3& p = torus.positions[j];
        x += along_x * Eigen::Vector3d(p[0], p[1], p[2]);
        y += along_y * Eigen::Vector3d(p[0], p[1], p[2]);
        constant = std::max({constant, std::abs(along_x), std::abs(along_y)});
      }
      EXPECT_NEAR(x.norm(), 1, 1e-9);
      EXPECT_NEAR(y.norm(), 1, 1e-9);
      EXPECT_NEAR(x.dot(y), 0, 1e-9);
      // The torus' own normal there, from its circle of radius 1 in the xz plane.
      const Vec3& p = torus.positions[i];
      const double ring = std::hypot(p[0], p[2]);
      const Eigen::Vector3d normal = Eigen::Vector3d(p[0] - p[0] / ring, p[1], p[2] - p[2] / ring) / 0.4;
      const double side = x.cross(y).dot(normal);
      EXPECT_GT(faces.empty() ? std::abs(side) : side, 0.99);
      // Tangents are aligned with those of the parent, here a neighbour on the grid, except at the end of a row.
      if (i % 40 != 0 && i % 20 != 0) {
        EXPECT_GT(x.dot(before), 0.9) << i;
      }
      before = x;
      double sum = 0;
      for (const auto& [j, along_x, along_y] : derivatives.of(i)) sum += along_x;
      EXPECT_NEAR(sum, 0, 1e-9 * constant) << "a constant has no slope";
    }
  }
}

TEST(TangentDerivatives, DegenerateFacesGiveNone) {
  const std::vector<Vec3> positions = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {0, 1, 0}, {5, 5, 5}};
  const std::vector<std::uint32_t> parents = {0, 0, 1, 0, 0};
  const TangentDerivatives derivatives =
      tangent_derivatives(positions, std::vector<Face>{{0, 1, 2}, {0, 1, 3}}, parents);
  EXPECT_EQ(derivatives.of(0).size(), 3u);
  EXPECT_TRUE(derivatives.of(2).empty());
  EXPECT_TRUE(derivatives.of(4).empty());
}

}  // namespace
}  // namespace eigencast
