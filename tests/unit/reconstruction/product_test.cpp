// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/asset/detail.h"
#include "common/reconstruction/kernel.h"
#include "common/reconstruction/reconstruct.h"
#include "tests/unit/reconstruction/coefficient_rounding.h"
#include "tests/unit/reconstruction/random_asset.h"

namespace eigencast {
namespace {

using testing::CoefficientRounding;
using testing::random_asset;
using testing::random_values;

// Asset of arbitrary numbers: the product does not need an orthonormal basis.
Asset any_asset(std::uint32_t n, std::uint32_t r) {
  Asset asset;
  asset.vertex_count = asset.rows_ready = n;
  asset.rank = r;
  for (const double value : random_values(std::size_t{n} * r)) asset.floats.push_back(static_cast<float>(value));
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
        const double term = static_cast<double>(asset.entry(i, k)) * C[k * channels + d];
        x += term;
        scale += std::abs(term);
      }
      ASSERT_NEAR(positions[3 * i + d], x, 1e-6 * scale + 1e-30)
          << "row " << i << " of " << N << ", rank " << rank << " of " << asset.rank << ", channels " << channels;
    }
  }
  for (std::size_t i = std::size_t{N} * 3; i < positions.size(); ++i) ASSERT_EQ(positions[i], kUntouched);
}

TEST(Product, MatchesTheSumAtAllRemainders) {
  for (std::uint32_t r = 1; r <= 19; ++r) {
    const Asset asset = any_asset(13, r);
    for (std::uint32_t N = 0; N <= 13; ++N) expect_product(asset, 3, r, N);
  }
}

TEST(Product, UsesOnlyTheFirstColumns) {
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

// An asset whose later columns lie on a grid, as decoded assets' do.
Asset grid_asset(std::uint32_t n, std::uint32_t r, std::uint32_t exact, double size = 9000, double largest = 32767) {
  Asset asset = any_asset(n, exact);
  asset.rank = r;
  const auto integers = random_values(std::size_t{n} * r, 4);
  for (std::uint32_t k = exact; k < r; ++k)
    asset.column_scales.push_back(k % 5 == 4 ? 0 : 1e-3F * static_cast<float>(k + 1));
  for (std::size_t i = 0; i < n; ++i) {
    for (std::uint32_t k = exact; k < r; ++k) {
      const double integer = i == k ? -largest : std::clamp(std::round(size * integers[i * r + k]), -largest, largest);
      asset.integers.push_back(static_cast<std::int16_t>(k % 5 == 4 ? 0 : integer));
    }
  }
  return asset;
}

/// Poses of different channels rebuilt at once, against the sum in double; nothing beyond row N may be written.
void expect_rebuilt(const Asset& asset, InstructionSet set, std::uint32_t rank, std::uint32_t N, std::size_t poses) {
  constexpr float kUntouched = 12345;
  Reconstructor reconstructor(set);
  reconstructor.update(asset);
  std::vector<std::vector<double>> C;
  std::vector<std::vector<float>> X(poses, std::vector<float>(std::size_t{N} * 3 + 8, kUntouched));
  std::vector<PoseToRebuild> jobs;
  for (std::size_t p = 0; p < poses; ++p) {
    C.push_back(random_values(std::size_t{rank} * (3 + p % 2), static_cast<unsigned>(7 + p)));
  }
  for (std::size_t p = 0; p < poses; ++p) jobs.push_back({C[p], static_cast<std::uint32_t>(3 + p % 2), X[p]});
  reconstructor.rebuild(jobs, rank, N);
  for (std::size_t p = 0; p < poses; ++p) {
    const CoefficientRounding rounded(asset, reconstructor.tiles(), C[p], static_cast<std::uint32_t>(3 + p % 2), rank);
    for (std::size_t i = 0; i < N; ++i) {
      const auto rounding = rounded.of(i);
      for (std::size_t d = 0; d < 3; ++d) {
        double x = 0, scale = 0;
        for (std::size_t k = 0; k < rank; ++k) {
          const double term = static_cast<double>(asset.entry(i, k)) * C[p][k * (3 + p % 2) + d];
          x += term;
          scale += std::abs(term);
        }
        ASSERT_NEAR(X[p][3 * i + d], x, 1e-6 * scale + rounding[d])
            << name_of(set) << ", row " << i << " of " << N << ", rank " << rank << " of " << asset.rank << ", pose "
            << p;
      }
    }
    for (std::size_t i = std::size_t{N} * 3; i < X[p].size(); ++i) ASSERT_EQ(X[p][i], kUntouched);
  }
}

TEST(Reconstructor, EveryInstructionSetMatchesTheSum) {
  const Asset floats = any_asset(150, 37), grid = grid_asset(150, 37, 4), all_grid = grid_asset(70, 9, 0);
  const Asset coarse = grid_asset(150, 37, 4, 100, 1000), all_coarse = grid_asset(70, 9, 0, 100, 1000);
  EXPECT_EQ(BasisTiles().tile_count(), 0U);
  for (const InstructionSet set : instruction_sets()) {
    for (const std::uint32_t N : {0U, 1U, 15U, 16U, 63U, 64U, 65U, 127U, 128U, 150U}) {
      for (const std::uint32_t rank : {0U, 1U, 3U, 4U, 5U, 36U, 37U}) {
        expect_rebuilt(floats, set, rank, N, 1);
        expect_rebuilt(grid, set, rank, N, 1);
        expect_rebuilt(coarse, set, rank, N, 1);
      }
    }
    for (std::size_t poses = 0; poses <= 8; ++poses) {
      expect_rebuilt(floats, set, 37, 130, poses);
      expect_rebuilt(grid, set, 31, 130, poses);
      expect_rebuilt(coarse, set, 31, 130, poses);
    }
    expect_rebuilt(all_grid, set, 9, 70, 2);
    expect_rebuilt(all_coarse, set, 9, 70, 3);
  }
}

TEST(Reconstructor, RoundedCoefficientsAddAtMostThreePercentError) {
  // A basis as bakes give them: columns that matter less lie on a coarser grid.
  constexpr std::uint32_t kRows = 400, kRank = 120;
  const auto truth = random_values(std::size_t{kRows} * kRank, 3);
  Asset asset;
  asset.vertex_count = asset.rows_ready = kRows;
  asset.rank = kRank;
  std::vector<double> C;
  for (std::uint32_t k = 4; k < kRank; ++k)
    asset.column_scales.push_back(1e-4F * std::pow(static_cast<float>(k + 1), 1.2F));
  for (std::size_t i = 0; i < kRows * kRank; ++i) {
    const auto value = static_cast<float>(truth[i]);
    if (i % kRank < 4) {
      asset.floats.push_back(value);
    } else {
      asset.integers.push_back(static_cast<std::int16_t>(std::lrint(value / asset.column_scales[i % kRank - 4])));
    }
  }
  const auto directions = random_values(std::size_t{kRank} * 3, 5);
  for (std::size_t i = 0; i < directions.size(); ++i)
    C.push_back(directions[i] * std::pow(1.0 + static_cast<double>(i / 3), -1.2));
  std::vector<double> only_one(C.size());
  only_one[3 * 20] = 7;
  for (const auto& pose : {C, only_one}) {
    Reconstructor reconstructor;
    reconstructor.update(asset);
    ASSERT_TRUE(reconstructor.tiles().whole_coefficients(pose, 3, kRank));
    std::vector<float> X(std::size_t{kRows} * 3);
    reconstructor.rebuild(pose, 3, kRank, kRows, X);
    double of_basis = 0, of_all = 0;
    for (std::size_t i = 0; i < X.size(); ++i) {
      double exact = 0, on_grid = 0;
      for (std::size_t k = 0; k < kRank; ++k) {
        exact += double{static_cast<float>(truth[i / 3 * kRank + k])} * pose[3 * k + i % 3];
        on_grid += double{asset.entry(i / 3, k)} * pose[3 * k + i % 3];
      }
      of_basis += (on_grid - exact) * (on_grid - exact);
      of_all += (static_cast<double>(X[i]) - exact) * (static_cast<double>(X[i]) - exact);
    }
    EXPECT_LE(std::sqrt(of_all), 1.035 * std::sqrt(of_basis));
  }
}

TEST(Reconstructor, KeepsFloatCoefficientsOnFineGrids) {
  BasisTiles fine, coarse;
  fine.update(grid_asset(100, 21, 4));
  coarse.update(grid_asset(100, 21, 4, 100, 1000));
  std::vector<double> C(63);
  C[30] = 1;
  EXPECT_FALSE(fine.whole_coefficients(C, 3, 21));
  EXPECT_TRUE(coarse.whole_coefficients(C, 3, 21));
  EXPECT_FALSE(coarse.whole_coefficients(C, 3, 4));
  for (const double bad : {std::nan(""), HUGE_VAL}) {
    C[31] = bad;
    EXPECT_FALSE(coarse.whole_coefficients(C, 3, 21));
  }
  EXPECT_TRUE(coarse.whole_coefficients(std::vector<double>(63), 3, 21)) << "a pose of zeros";
}

TEST(Kernel, IntegerCoefficientsSumExactly) {
  AlignedVector<std::int16_t> integers(2 * kernel::kTileRows);
  for (std::size_t i = 0; i < kernel::kTileRows; ++i) {
    integers[kernel::offset_of_integer(i, 0)] = i % 2 == 0 ? 32767 : -32767;
    integers[kernel::offset_of_integer(i, 1)] = i % 3 == 0 ? 32767 : -32767;
  }
  const kernel::Tiles tiles{nullptr, integers.data(), 0, 0, 2, 2};
  const std::vector<std::int16_t> whole{32767, 32767, -32767, 32767, 1, -2};
  std::vector<float> X(3 * kernel::kTileRows);
  kernel::Pose pose{nullptr, whole.data(), {1, 1, 0.5F}, X.data()};
  for (const InstructionSet set : instruction_sets()) {
    kernel::functions(set).product(tiles, kernel::kTileRows, &pose, 1);
    for (std::size_t i = 0; i < kernel::kTileRows; ++i) {
      const double a = integers[2 * i], b = integers[2 * i + 1];
      EXPECT_EQ(X[3 * i], static_cast<float>(32767 * a + 32767 * b)) << name_of(set);
      EXPECT_EQ(X[3 * i + 1], static_cast<float>(-32767 * a + 32767 * b)) << name_of(set);
      EXPECT_EQ(X[3 * i + 2], static_cast<float>(0.5 * (a - 2 * b))) << name_of(set);
    }
  }
}

TEST(Reconstructor, SeveralThreadsGiveTheSameBits) {
  const Asset asset = grid_asset(9000, 60, 4);
  const auto C = random_values(180);
  std::vector<float> alone(27000), together(27000);
  std::vector<std::vector<float>> six(6, std::vector<float>(27000));
  Reconstructor one(instruction_sets().back(), 1), many;
  one.update(asset);
  many.update(asset);
  one.rebuild(C, 3, 60, 9000, alone);
  std::vector<PoseToRebuild> jobs;
  for (auto& X : six) jobs.push_back({C, 3, X});
  many.rebuild(jobs, 60, 9000);
  many.rebuild(C, 3, 60, 9000, together);
  EXPECT_EQ(alone, together);
  for (const auto& X : six) {
    for (std::size_t i = 0; i < X.size(); ++i) ASSERT_NEAR(X[i], alone[i], 1e-2F);
  }
}

TEST(Reconstructor, FollowsAnAssetThatArrives) {
  const Asset whole = grid_asset(200, 21, 4);
  Reconstructor reconstructor, at_once;
  at_once.update(whole);
  EXPECT_TRUE(at_once.tiles().has_integers());
  const auto C = random_values(63);
  for (const std::uint32_t rows : {1U, 60U, 64U, 100U, 200U}) {
    Asset part = whole;
    part.rows_ready = rows;
    part.floats.resize(std::size_t{rows} * 4);
    part.integers.resize(std::size_t{rows} * 17);
    reconstructor.update(part);
    ASSERT_EQ(reconstructor.tiles().rows(), rows);
    std::vector<float> a(std::size_t{rows} * 3), b(std::size_t{rows} * 3);
    reconstructor.rebuild(C, 3, 21, rows, a);
    at_once.rebuild(C, 3, 21, rows, b);
    // How coefficients are rounded depends on the rows that are there.
    const CoefficientRounding of_part(part, reconstructor.tiles(), C, 3, 21), of_whole(part, at_once.tiles(), C, 3, 21);
    for (std::size_t i = 0; i < rows; ++i) {
      const auto x = of_part.of(i), y = of_whole.of(i);
      for (std::size_t d = 0; d < 3; ++d) ASSERT_NEAR(a[3 * i + d], b[3 * i + d], x[d] + y[d] + 1e-3);
    }
  }
}

TEST(Reconstructor, IntegersAreThoseOfTheAsset) {
  const Asset asset = grid_asset(200, 21, 4);
  BasisTiles tiles;
  tiles.reserve(asset);
  tiles.update(asset, 100);
  tiles.update(asset);
  const kernel::Tiles view = tiles.view(0, 21);
  for (std::size_t i = 0; i < 200; ++i) {
    const std::size_t tile = i / kernel::kTileRows, row = i % kernel::kTileRows;
    for (std::size_t k = 4; k < 21; ++k) {
      const std::size_t at = tile * kernel::kTileRows * view.integer_stride + kernel::offset_of_integer(row, k - 4);
      ASSERT_EQ(view.integers[at], asset.integers[i * 17 + k - 4]);
    }
  }
}

/// Detail of arbitrary numbers, of derivatives that may span any frame.
void add_detail(Asset& asset) {
  const std::size_t n = asset.vertex_count, r = asset.rank;
  asset.detail.steps.assign(r, 1e-4F);
  const auto entries = [&](unsigned seed) {
    std::vector<std::int16_t> all;
    for (const double value : random_values(n * r, seed))
      all.push_back(static_cast<std::int16_t>(std::clamp(8000 * value, -32767.0, 32767.0)));
    return all;
  };
  asset.detail.along_x = entries(11);
  asset.detail.along_y = entries(12);
  const auto offsets = random_values(3 * n, 13);
  for (std::size_t i = 0; i < n; ++i) {
    asset.detail.offset.push_back({static_cast<float>(offsets[3 * i]), static_cast<float>(offsets[3 * i + 1]),
                                   static_cast<float>(offsets[3 * i + 2])});
    asset.detail.normal.push_back({0.6F, 0, 0.8F});
  }
}

TEST(Reconstructor, AddsDetailInTheFramesOfThePose) {
  Asset asset = grid_asset(3000, 21, 4);
  add_detail(asset);
  const auto C = random_values(63);
  for (const InstructionSet set : instruction_sets()) {
    Reconstructor reconstructor(set);
    reconstructor.update(asset);
    ASSERT_TRUE(reconstructor.has_detail());
    std::vector<float> base(9000), X(9000), normals(9000);
    reconstructor.combine(C, 3, 21, 3000, base);
    const PoseToRebuild pose{C, 3, X, normals};
    reconstructor.rebuild({&pose, 1}, 21, 3000);
    for (std::size_t i = 0; i < 3000; ++i) {
      std::array<double, 3> u{}, v{}, offset{};
      for (std::size_t k = 0; k < 21; ++k) {
        for (std::size_t d = 0; d < 3; ++d) {
          u[d] += 1e-4 * asset.detail.along_x[i * 21 + k] * C[3 * k + d];
          v[d] += 1e-4 * asset.detail.along_y[i * 21 + k] * C[3 * k + d];
        }
      }
      const auto frame = frame_from_derivatives(u, v);
      for (std::size_t d = 0; d < 3; ++d) offset[d] = double{asset.detail.offset[i][d]};
      offset = frame.from_frame(offset);
      const auto normal = frame.from_frame({0.6, 0, 0.8});
      // A frame of almost no area turns with the rounding of what spans it.
      const double area = std::hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
      const double tolerance = 1e-4 + 3e-3 / std::max(area, 1e-2);
      for (std::size_t d = 0; d < 3; ++d) {
        ASSERT_NEAR(X[3 * i + d] - base[3 * i + d], offset[d], tolerance) << "row " << i << ", area " << area;
        ASSERT_NEAR(normals[3 * i + d], normal[d], tolerance) << "row " << i << ", area " << area;
      }
    }
    // The same bits at every level, from any row on, on any number of threads, with and without normals.
    std::vector<float> some(3 * 1500), alone(9000);
    reconstructor.rebuild(C, 3, 21, 1500, some);
    EXPECT_TRUE(std::equal(some.begin(), some.end(), X.begin()));
    const PoseToRebuild rest{C, 3, some, {}};
    std::fill(some.begin() + 3 * 1100, some.end(), 0.0F);
    reconstructor.rebuild({&rest, 1}, 21, 1500, 1100);
    EXPECT_TRUE(std::equal(some.begin(), some.end(), X.begin()));
    Reconstructor one(set, 1);
    one.update(asset);
    one.rebuild(C, 3, 21, 3000, alone);
    EXPECT_EQ(alone, X);
  }
}

TEST(Reconstructor, FollowsDetailThatArrivesAndEnds) {
  Asset whole = grid_asset(200, 21, 4);
  add_detail(whole);
  Reconstructor reconstructor;
  for (const std::uint32_t rows : {60U, 100U, 200U}) {
    Asset part = whole;
    part.rows_ready = rows;
    part.floats.resize(std::size_t{rows} * 4);
    part.integers.resize(std::size_t{rows} * 17);
    part.detail.along_x.resize(std::size_t{rows} * 21);
    part.detail.along_y.resize(std::size_t{rows} * 21);
    part.detail.offset.resize(rows);
    part.detail.normal.resize(rows);
    reconstructor.update(part);
    EXPECT_EQ(reconstructor.has_detail(), true);
  }
  whole.detail = {};
  reconstructor.update(whole);
  EXPECT_FALSE(reconstructor.has_detail());
  const auto C = random_values(63);
  std::vector<float> base(600), X(600);
  reconstructor.combine(C, 3, 21, 200, base);
  reconstructor.rebuild(C, 3, 21, 200, X);
  EXPECT_EQ(base, X);
}

TEST(Kernel, TransposedProductMatchesTheSum) {
  for (const Asset& asset : {any_asset(200, 19), grid_asset(200, 19, 4)}) {
    BasisTiles tiles;
    tiles.update(asset);
    std::vector<float> Y(4 * 3 * kernel::kTileRows);
    const auto values = random_values(600);
    for (std::size_t i = 0; i < 200; ++i) {
      for (std::size_t d = 0; d < 3; ++d) Y[(i / 64 * 3 + d) * 64 + i % 64] = static_cast<float>(values[3 * i + d]);
    }
    for (const InstructionSet set : instruction_sets()) {
      std::vector<double> S(60, 1.0);  // with room for the partner of an odd column
      AlignedVector<float> scratch(60 * kernel::kWidestVector);
      kernel::functions(set).add_transposed(tiles.view(0, 19), 4, Y.data(), S.data(), scratch.data());
      for (std::uint32_t k = 0; k < 19; ++k) {
        for (std::size_t d = 0; d < 3; ++d) {
          double expected = 0, scale = 0;
          for (std::size_t i = 0; i < 200; ++i) {
            const double term = double{asset.entry(i, k)} * double{static_cast<float>(values[3 * i + d])};
            expected += term;
            scale += std::abs(term);
          }
          ASSERT_NEAR((S[3 * k + d] - 1) * tiles.scale(k), expected, 1e-6 * scale) << name_of(set);
        }
      }
    }
  }
}

TEST(Kernel, GramMatchesTheSum) {
  for (const std::size_t width : {8U, 16U, 40U, 200U}) {
    const std::size_t rows = 21;
    const auto B = random_values(rows * width);
    for (const InstructionSet set : instruction_sets()) {
      std::vector<double> G(width * width, 0.5);
      kernel::functions(set).add_gram(B.data(), rows, width, G.data());
      for (std::size_t i = 0; i < width; ++i) {
        for (std::size_t j = 0; j <= i; ++j) {
          double expected = 0.5;
          for (std::size_t row = 0; row < rows; ++row) expected += B[row * width + i] * B[row * width + j];
          ASSERT_NEAR(G[i * width + j], expected, 1e-12);
        }
      }
    }
  }
}

TEST(Kernel, InverseOfAFactorSolves) {
  for (const std::size_t rows : {1U, 7U, 8U, 9U, 37U}) {
    const std::size_t width = (rows + 7) / 8 * 8;
    auto T = random_values(rows * width);
    auto S = random_values(3 * width, 3);
    for (std::size_t i = 0; i < rows; ++i)
      std::fill(T.begin() + static_cast<std::ptrdiff_t>(i * width + i + 1),
                T.begin() + static_cast<std::ptrdiff_t>((i + 1) * width), 0.0);
    for (const InstructionSet set : instruction_sets()) {
      std::vector<double> C(3 * width, 0.25);
      kernel::functions(set).add_inverse(T.data(), rows, width, S.data(), C.data());
      for (std::size_t k = 0; k < 3 * width; ++k) {
        double expected = 0.25;
        for (std::size_t i = 0; i < rows; ++i) {
          double y = 0;
          for (std::size_t j = 0; j < width; ++j) y += T[i * width + j] * S[k / width * width + j];
          expected += T[i * width + k % width] * y;
        }
        ASSERT_NEAR(C[k], expected, 1e-11 * (1 + std::abs(expected))) << name_of(set) << ", " << rows << " rows";
      }
    }
  }
}

}  // namespace
}  // namespace eigencast
