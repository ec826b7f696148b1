// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include "common/reconstruction/kernel.h"
#include "common/reconstruction/reconstruct.h"
#include "tests/unit/reconstruction/random_asset.h"

namespace eigencast {
namespace {

using testing::random_asset;
using testing::random_values;

// Asset of arbitrary numbers: the product does not need an orthonormal basis.
Asset any_asset(std::uint32_t n, std::uint32_t r) {
  Asset asset;
  asset.vertex_count = asset.rows_ready = n;
  asset.rank = r;
  for (const double value : random_values(std::size_t{n} * r)) asset.basis.push_back(static_cast<float>(value));
  return asset;
}

void expect_product(const Asset& asset, std::uint32_t channels, std::uint32_t rank, std::uint32_t N) {
  const auto C = random_values(std::size_t{rank} * channels, 7);
  constexpr float kUntouched = 12345;
  std::vector<float> positions(std::size_t{N} * 3 + 8, kUntouched);
  positions_from_coefficients(asset, C, channels, rank, N, positions);
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      double x = 0, scale = 0;
      for (std::size_t k = 0; k < rank; ++k) {
        const double term = static_cast<double>(asset.basis[i * asset.rank + k]) * C[k * channels + d];
        x += term;
        scale += std::abs(term);
      }
      ASSERT_NEAR(positions[3 * i + d], x, 1e-6 * scale + 1e-30)
          << "row " << i << " of " << N << ", rank " << rank << " of " << asset.rank << ", channels " << channels;
    }
  }
  for (std::size_t i = std::size_t{N} * 3; i < positions.size(); ++i) ASSERT_EQ(positions[i], kUntouched);
}

TEST(Product, AgreesWithTheSumAtAllRemaindersOfRowsAndRank) {
  for (std::uint32_t r = 1; r <= 19; ++r) {
    const Asset asset = any_asset(13, r);
    for (std::uint32_t N = 0; N <= 13; ++N) expect_product(asset, 3, r, N);
  }
}

TEST(Product, UsesOnlyTheFirstColumnsOfALargerBasis) {
  const Asset asset = any_asset(37, 200);
  for (const std::uint32_t rank : {1U, 14U, 54U, 104U, 199U, 200U}) expect_product(asset, 3, rank, 37);
}

TEST(Product, SkipsFurtherChannels) {
  const Asset asset = any_asset(10, 21);
  for (const std::uint32_t channels : {3U, 4U, 7U}) expect_product(asset, channels, 21, 10);
}

TEST(Product, LevelsArePrefixesToTheBit) {
  const Asset asset = any_asset(50, 30);
  const auto C = random_values(90);
  std::vector<float> all(150), some(150);
  positions_from_coefficients(asset, C, 3, 30, 50, all);
  for (std::uint32_t N = 0; N < 50; ++N) {
    positions_from_coefficients(asset, C, 3, 30, N, some);
    ASSERT_TRUE(std::equal(some.begin(), some.begin() + 3 * N, all.begin())) << "N = " << N;
  }
}

TEST(Kernel, TransposedProductAgreesWithTheSum) {
  for (std::size_t r = 1; r <= 19; ++r) {
    for (std::size_t rows = 0; rows <= 9; ++rows) {
      const Asset asset = any_asset(static_cast<std::uint32_t>(rows + 1), static_cast<std::uint32_t>(r));
      std::vector<float> Y, S(3 * r, 1.0F);
      for (const double value : random_values(3 * rows)) Y.push_back(static_cast<float>(value));
      kernel::add_transposed_product(asset.basis.data(), rows, r, Y.data(), S.data());
      for (std::size_t k = 0; k < r; ++k) {
        for (std::size_t d = 0; d < 3; ++d) {
          double expected = 1;
          for (std::size_t i = 0; i < rows; ++i) expected += double{asset.basis[i * r + k]} * double{Y[3 * i + d]};
          ASSERT_NEAR(S[d * r + k], expected, 2e-5);
        }
      }
    }
  }
}

TEST(Kernel, GramAgreesWithTheSum) {
  for (const std::size_t width : {8U, 16U, 40U}) {
    const std::size_t rows = 21;
    const auto B = random_values(rows * width);
    std::vector<double> G(width * width, 0.5);
    kernel::add_gram(B.data(), rows, width, G.data());
    for (std::size_t i = 0; i < width; ++i) {
      for (std::size_t j = 0; j <= i; ++j) {
        double expected = 0.5;
        for (std::size_t row = 0; row < rows; ++row) expected += B[row * width + i] * B[row * width + j];
        ASSERT_NEAR(G[i * width + j], expected, 1e-12);
      }
    }
  }
}

}  // namespace
}  // namespace eigencast
