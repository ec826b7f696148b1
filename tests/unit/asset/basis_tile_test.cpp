// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <limits>
#include <random>

#include "common/asset/format/encode.h"
#include "common/asset/format/reader.h"
#include "common/asset/tiles/basis_tile.h"
#include "common/asset/tiles/number_coder.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

/// A basis whose integer columns lie on their grid, with predictors as assets have them, in two blocks of rows.
struct Basis {
  static constexpr std::uint32_t kExact = 4;
  std::uint32_t rows, rank;
  std::vector<float> scales, entries;
  Predictors predictors;

  Basis(std::uint32_t row_count, std::uint32_t columns) : rows(row_count), rank(columns), entries(rows * rank) {
    std::mt19937 random(7);
    for (std::uint32_t k = kExact; k < rank; ++k)
      scales.push_back(k % 7 == 6 ? 0 : std::ldexp(1.0F, -static_cast<int>(k)));
    for (std::uint32_t i = 0; i < rows; ++i) {
      for (std::uint32_t j = 0; j < std::min(i, i % 9); ++j) {
        predictors.rows.push_back(static_cast<std::uint32_t>(random() % i));
        predictors.weights.push_back(static_cast<std::int16_t>(static_cast<int>(random() % 1023) - 511));
      }
      predictors.end_row();
    }
  }
  float& at(std::uint32_t i, std::uint32_t k) { return entries[i * rank + k]; }

  /// Room to read it into.
  struct Read {
    std::vector<float> floats;
    std::vector<std::int16_t> integers;
    explicit Read(const Basis& basis)
        : floats(basis.rows * kExact, 77), integers(basis.rows * (basis.rank - kExact), 77) {}
    BasisRows rows() { return {floats, integers}; }
  };

  void expect_to_come_back() const {
    for (const auto& [lo, hi] : {std::pair{0u, rank}, {0u, 3u}, {2u, 5u}, {5u, rank}}) {
      Read read(*this);
      for (const auto& [first, end] : {std::pair{0u, rows / 3}, {rows / 3, rows}}) {
        const Predictors part = part_of(predictors, first, end);
        const BasisBlock block{first, end, lo, hi, kExact, rank, scales, part};
        const Bytes coded = encode_basis(block, entries);
        const auto result = decode_basis(block, coded, read.rows());
        ASSERT_TRUE(result) << result.error().message;
      }
      for (std::uint32_t i = 0; i < rows; ++i) {
        for (std::uint32_t k = 0; k < rank; ++k) {
          const bool is_there = k >= lo && k < hi;
          if (k < kExact) {
            ASSERT_EQ(std::bit_cast<std::uint32_t>(read.floats[i * kExact + k]),
                      std::bit_cast<std::uint32_t>(is_there ? entries[i * rank + k] : 77.0F))
                << i << ", " << k;
          } else {
            const std::int16_t integer = read.integers[i * (rank - kExact) + k - kExact];
            const float expected = is_there ? entries[i * rank + k] : 77 * scales[k - kExact];
            ASSERT_EQ(static_cast<float>(integer) * scales[k - kExact], expected) << i << ", " << k;
          }
        }
      }
    }
  }
};

TEST(BasisTile, EveryFloatAndIntegerRoundTripsToTheBit) {
  std::mt19937 random(3);
  using Limits = std::numeric_limits<float>;
  for (const bool extreme : {false, true}) {
    Basis basis(211, 23);
    for (std::uint32_t i = 0; i < basis.rows; ++i) {
      for (std::uint32_t k = 0; k < Basis::kExact; ++k) {
        const float chosen[] = {0, -0.0F, Limits::denorm_min(), -Limits::min(), Limits::max(), Limits::lowest(), 1};
        const auto any = std::bit_cast<float>(static_cast<std::uint32_t>(random()));
        basis.at(i, k) = extreme ? chosen[random() % 7] : std::isfinite(any) ? any : 3.0F;
      }
      for (std::uint32_t k = Basis::kExact; k < basis.rank; ++k) {
        const int chosen[] = {0, -1, 32767, -32767};
        const int integer = extreme ? chosen[random() % 4] : static_cast<int>(random() % 65535) - 32767;
        basis.at(i, k) = static_cast<float>(integer) * basis.scales[k - Basis::kExact];
        if (basis.scales[k - Basis::kExact] == 0) basis.at(i, k) = 0;
      }
    }
    basis.expect_to_come_back();
  }
}

TEST(BasisTile, AConstantColumnCostsNothing) {
  Asset asset = sample_asset(4, 12);
  const auto size = [&] { return encode_asset(asset).value().total_bytes(); };
  const std::size_t before = size();
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) asset.floats[i * 12 + 1] = 0.3F;
  EXPECT_LT(size() + asset.vertex_count, before);
  const std::size_t constant = size();
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) asset.floats[i * 12 + 1] = 0;
  EXPECT_NEAR(static_cast<double>(size()), static_cast<double>(constant), 200);
}

TEST(BasisTile, RefusesBytesThatNoWriterWrites) {
  Basis basis(40, 9);
  const Predictors part = part_of(basis.predictors, 0, 40);
  const BasisBlock block{0, 40, 0, 9, Basis::kExact, 9, basis.scales, part};
  Basis::Read read(basis);
  Bytes longer = encode_basis(block, basis.entries);
  longer.insert(longer.end(), 8, 1);
  EXPECT_FALSE(decode_basis(block, longer, read.rows()));
  int refused = 0;
  std::mt19937 random(1);
  for (int trial = 0; trial < 300; ++trial) {
    Bytes any(random() % 400);
    for (auto& byte : any) byte = static_cast<std::uint8_t>(random());
    const auto result = decode_basis(block, any, read.rows());
    if (!result) {
      ++refused;
      continue;
    }
    for (const float entry : read.floats) ASSERT_TRUE(std::isfinite(entry));
  }
  EXPECT_GT(refused, 290);
}

TEST(AdaptiveBit, IsNeverCertain) {
  for (const bool decision : {false, true}) {
    AdaptiveBit bit;
    for (int i = 0; i < 100'000; ++i) {
      bit.learn(decision);
      ASSERT_GT(bit.probability(), 0u);
      ASSERT_LT(bit.probability(), 1u << 15);
    }
    EXPECT_NEAR(bit.probability(), decision ? 32768 : 0, 60);
  }
}

}  // namespace
}  // namespace eigencast
