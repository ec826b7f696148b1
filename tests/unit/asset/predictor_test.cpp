// SPDX-License-Identifier: MIT
#include "common/asset/tiles/predictor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <random>

#include "common/asset/format/encode.h"
#include "common/asset/format/reader.h"
#include "common/asset/tiles/basis_tile.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

TEST(Predictors, PrecedeTheirRowAndBeatItsParent) {
  for (const bool cloud : {false, true}) {
    const Asset asset = sample_asset(4, 30, cloud);
    const std::vector<float> scales = column_scales_from_basis(asset.floats, asset.rank, 4, {});
    const Predictors all = choose_predictors(asset, 4, scales);
    ASSERT_EQ(all.row_count(), asset.vertex_count);
    for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
      ASSERT_LE(all.first[i + 1] - all.first[i], Predictors::kMaxPerRow);
      for (std::uint32_t at = all.first[i]; at < all.first[i + 1]; ++at) {
        ASSERT_LT(all.rows[at], i);
        ASSERT_LE(std::abs(int{all.weights[at]}), Predictors::kMaxWeight);
      }
    }
    double left = 0, parents = 0;
    for (std::uint32_t k = 4; k < asset.rank; ++k) {
      std::vector<std::int16_t> column(asset.vertex_count);
      for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
        const float value = asset.entry(i, k) / scales[k - 4];
        column[i] = static_cast<std::int16_t>(std::lrint(value));
        if (i < asset.base_count) continue;
        left += std::abs(column[i] - all.predict(i, column));
        parents += std::abs(column[i] - column[asset.map[i]]);
      }
    }
    EXPECT_LT(left, 0.5 * parents);
  }
}

TEST(Predictors, PartsEqualTheWhole) {
  const Asset asset = sample_asset(2, 9);
  const std::vector<float> scales = column_scales_from_basis(asset.floats, asset.rank, 4, {});
  const Predictors all = choose_predictors(asset, 4, scales);
  const Predictors part = part_of(all, 20, 90);
  ASSERT_EQ(part.row_count(), 70u);
  std::vector<std::int16_t> column(asset.vertex_count);
  for (std::size_t i = 0; i < column.size(); ++i) column[i] = static_cast<std::int16_t>(37 * i % 1001);
  for (std::size_t i = 0; i < 70; ++i) EXPECT_EQ(part.predict(i, column), all.predict(20 + i, column));
}

TEST(Predictors, ExtremesOfWeightsAndValuesFit32Bits) {
  Predictors extreme;
  for (std::uint32_t k = 0; k < Predictors::kMaxPerRow; ++k) {
    extreme.rows.push_back(0);
    extreme.weights.push_back(Predictors::kMaxWeight);
  }
  extreme.end_row();
  const std::vector<std::int16_t> column{32767};
  EXPECT_EQ(extreme.predict(0, column), (8LL * 511 * 32767 + 32) >> 6);
}

/// The error that rounding the basis adds is the one asked for when coefficients are as large as was said: no more, and
/// not so much less that bytes were wasted.
TEST(AssetEncoding, StepsGiveTheRequestedError) {
  const Asset asset = sample_asset(4, 40);
  AssetEncoding encoding;
  encoding.error = 0.01;
  for (std::uint32_t k = 0; k < asset.rank; ++k) encoding.amplitudes.push_back(2.0 / (k + 1));
  const auto encoded = encode_asset(asset, encoding);
  ASSERT_TRUE(encoded) << encoded.error().message;
  const auto decoded = decode_asset(*encoded);
  ASSERT_TRUE(decoded) << decoded.error().message;
  std::mt19937 random(1);
  std::vector<std::array<double, 3>> C(asset.rank);
  for (std::uint32_t k = 0; k < asset.rank; ++k) {
    double squared = 0;
    for (double& c : C[k]) {
      c = static_cast<double>(random()) / 2147483648.0 - 1;
      squared += c * c;
    }
    for (double& c : C[k]) c *= encoding.amplitudes[k] / std::sqrt(squared);
  }
  double sum = 0;
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    std::array<double, 3> moved{};
    for (std::uint32_t k = 0; k < asset.rank; ++k) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        moved[axis] += (double{decoded->entry(i, k)} - double{asset.entry(i, k)}) * C[k][axis];
    }
    for (const double m : moved) sum += m * m;
  }
  const double rms = std::sqrt(sum / asset.vertex_count);
  EXPECT_LE(rms, 1.1 * encoding.error);
  EXPECT_GE(rms, 0.6 * encoding.error);
  const auto finest = encode_asset(asset);
  ASSERT_TRUE(finest);
  EXPECT_LT(encoded->total_bytes(), finest->total_bytes() / 2);
}

}  // namespace
}  // namespace eigencast
