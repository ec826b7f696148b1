// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>
#include <cmath>

#include <limits>

#include "common/reconstruction/reconstruct.h"
#include "tests/unit/reconstruction/random_asset.h"

namespace eigencast {
namespace {

using testing::random_asset;
using testing::random_values;

// Positions in the source's order and space, in double, from coefficients.
std::vector<double> source_positions(const Asset& asset, const std::vector<double>& C) {
  std::vector<double> positions(std::size_t{asset.vertex_count} * 3);
  for (std::size_t i = 0; i < asset.vertex_count; ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      double x = asset.origin[d];
      for (std::size_t k = 0; k < asset.rank; ++k) x += double{asset.entry(i, k)} * C[3 * k + d];
      positions[3 * asset.source_vertex[i] + d] = x;
    }
  }
  return positions;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = a.size() == b.size() ? 0 : std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

Projector projector_of(const Asset& asset) {
  auto projector = Projector::create(asset);
  EXPECT_TRUE(projector) << (projector ? "" : projector.error().message);
  return *projector;
}

TEST(Projector, InvertsReconstruction) {
  for (const auto& [n, r] : {std::pair{500U, 40U}, {97U, 13U}, {33U, 8U}, {40U, 40U}, {4U, 1U}}) {
    Asset asset = random_asset(n, r);
    asset.origin = {100, -20, 3};
    const auto C = random_values(std::size_t{r} * 3);
    const auto back = projector_of(asset).coefficients_from_positions(source_positions(asset, C));
    ASSERT_TRUE(back);
    EXPECT_LT(largest_difference(*back, C), 5e-6) << n << " x " << r;
  }
}

TEST(Projector, TakesNoOriginFromVectors) {
  Asset asset = random_asset(300, 12);
  asset.origin = {100, -20, 3};
  const std::vector<double> C = random_values(36);
  std::vector<double> vectors = source_positions(asset, C);
  for (std::size_t i = 0; i < vectors.size(); ++i) vectors[i] -= asset.origin[i % 3];
  const auto found = projector_of(asset).coefficients_from_vectors(std::span<const double>(vectors));
  ASSERT_TRUE(found);
  EXPECT_LT(largest_difference(C, *found), 1e-4);  // the sums of positions are made in double, and large
}

// The Gram matrix takes out what quantising did to orthonormality: without it the error would be of the noise's size.
TEST(Projector, ToleratesBasisQuantisation) {
  const Asset asset = random_asset(600, 50, 0.02);
  const auto C = random_values(150);
  const auto positions = source_positions(asset, C);
  const auto back = projector_of(asset).coefficients_from_positions(positions);
  ASSERT_TRUE(back);
  EXPECT_LT(largest_difference(*back, C), 5e-6);

  std::vector<double> plain(150);
  for (std::size_t i = 0; i < 600; ++i) {
    for (std::size_t k = 0; k < 50; ++k) {
      for (std::size_t d = 0; d < 3; ++d) {
        plain[3 * k + d] +=
            double{asset.entry(i, k)} * double{asset.mass[i]} * positions[3 * asset.source_vertex[i] + d];
      }
    }
  }
  EXPECT_GT(largest_difference(plain, C), 1e-3) << "the noise is too small to show anything";
}

TEST(Projector, ResidualIsOrthogonalToTheBasis) {
  const Asset asset = random_asset(400, 30, 1e-3);
  const auto positions = random_values(1200, 9);
  const auto C = projector_of(asset).coefficients_from_positions(positions);
  ASSERT_TRUE(C);
  const auto rebuilt = source_positions(asset, *C);
  for (std::size_t k = 0; k < 30; ++k) {
    for (std::size_t d = 0; d < 3; ++d) {
      double inner = 0;
      for (std::size_t i = 0; i < 400; ++i) {
        const std::size_t at = 3 * asset.source_vertex[i] + d;
        inner += double{asset.entry(i, k)} * std::sqrt(double{asset.mass[i]}) * (positions[at] - rebuilt[at]);
      }
      EXPECT_NEAR(inner, 0, 2e-5);
    }
  }
}

// A basis that spans the constants and the rest pose follows every affine image of the rest pose.
TEST(Projector, IsExactOnAffineImages) {
  const std::uint32_t n = 700, r = 24;
  Asset asset = random_asset(n, r);
  const auto rest_C = random_values(std::size_t{r} * 3, 5);
  // Columns 1 to 3 become the rest pose, so that its affine images lie in the span.
  const auto rest = source_positions(asset, rest_C);
  double scale = 0;
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      const double x = rest[3 * asset.source_vertex[i] + d];
      asset.floats[i * r + 1 + d] = static_cast<float>(x);
      scale = std::max(scale, std::abs(static_cast<double>(static_cast<float>(x))));
    }
  }
  const double A[3][4] = {{1.2, 0.3, -0.1, 5}, {0, 0.7, 0.4, -2}, {-0.5, 0.1, 1.1, 0.3}};
  std::vector<double> image(std::size_t{n} * 3);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t at = 3 * asset.source_vertex[i];
    for (std::size_t d = 0; d < 3; ++d) {
      image[at + d] = A[d][3];
      for (std::size_t e = 0; e < 3; ++e) image[at + d] += A[d][e] * double{asset.entry(i, 1 + e)};
    }
  }
  const auto C = projector_of(asset).coefficients_from_positions(image);
  ASSERT_TRUE(C);
  std::vector<float> rebuilt(std::size_t{n} * 3);
  positions_from_coefficients(asset, *C, 3, r, n, rebuilt);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      ASSERT_NEAR(rebuilt[3 * i + d], image[3 * asset.source_vertex[i] + d], 1e-5 * (scale + 5));
    }
  }
}

TEST(Projector, FloatAndDoublePositionsAgree) {
  const Asset asset = random_asset(300, 20);
  const auto positions = source_positions(asset, random_values(60));
  const std::vector<float> rounded(positions.begin(), positions.end());
  const Projector projector = projector_of(asset);
  const auto a = projector.coefficients_from_positions(positions);
  const auto b = projector.coefficients_from_positions(rounded);
  ASSERT_TRUE(a && b);
  EXPECT_LT(largest_difference(*a, *b), 1e-5);
}

TEST(Projector, EveryInstructionSetAndThreadAgrees) {
  const Asset asset = random_asset(5000, 30);
  const auto C = random_values(90);
  const auto positions = source_positions(asset, C);
  for (const InstructionSet set : instruction_sets()) {
    std::vector<std::vector<double>> found;
    for (const unsigned threads : {1U, 0U}) {
      const auto projector = Projector::create(asset, set, threads);
      ASSERT_TRUE(projector);
      const auto back = projector->coefficients_from_positions(positions);
      ASSERT_TRUE(back);
      EXPECT_LT(largest_difference(*back, C), 5e-6) << name_of(set);
      found.push_back(*back);
    }
    EXPECT_EQ(found[0], found[1]) << "threads change the sum";
  }
}

TEST(Projector, RefusesNonFinitePositions) {
  const Asset asset = random_asset(50, 5);
  const Projector projector = projector_of(asset);
  std::vector<float> positions(150, 1.0F);
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
    positions[3 * 31 + 1] = bad;
    const auto C = projector.coefficients_from_positions(positions);
    ASSERT_FALSE(C);
    EXPECT_EQ(C.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(C.error().message.find("vertex 31 "), std::string::npos) << C.error().message;
  }
}

TEST(Projector, RefusesWrongSizes) {
  const Asset asset = random_asset(50, 5);
  const auto C = projector_of(asset).coefficients_from_positions(std::vector<double>(147));
  ASSERT_FALSE(C);
  EXPECT_EQ(C.error().code, ErrorCode::kInvalidArgument);
}

TEST(Projector, RefusesDependentColumns) {
  Asset asset = random_asset(60, 6);
  for (std::size_t i = 0; i < 60; ++i) asset.floats[i * 6 + 4] = asset.floats[i * 6 + 2];
  const auto projector = Projector::create(asset);
  ASSERT_FALSE(projector);
  EXPECT_EQ(projector.error().code, ErrorCode::kNumerical);
  EXPECT_NE(projector.error().message.find("column 4"), std::string::npos) << projector.error().message;
}

}  // namespace
}  // namespace eigencast
