// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <random>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast::testing {

// A complete asset without faces. Its basis is random and M-orthonormal (in double, then rounded to float); `noise` is
// added to each entry relative to the largest of its column, as quantising it does.
inline Asset random_asset(std::uint32_t n, std::uint32_t r, double noise = 0, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0, 1);
  Asset asset;
  asset.vertex_count = asset.rows_ready = n;
  asset.rank = r;
  asset.base_count = std::min(n, 4U);
  for (std::uint32_t i = 0; i < n; ++i) asset.mass.push_back(static_cast<float>(0.5 + uniform(random)));
  std::vector<std::vector<double>> columns(r, std::vector<double>(n));
  for (std::uint32_t k = 0; k < r; ++k) {
    auto& column = columns[k];
    for (double& value : column) value = k == 0 ? 1 : normal(random);
    for (int twice = 0; twice < 2; ++twice) {
      for (std::uint32_t j = 0; j < k; ++j) {
        double along = 0;
        for (std::uint32_t i = 0; i < n; ++i) along += column[i] * columns[j][i] * asset.mass[i];
        for (std::uint32_t i = 0; i < n; ++i) column[i] -= along * columns[j][i];
      }
      double norm = 0;
      for (std::uint32_t i = 0; i < n; ++i) norm += column[i] * column[i] * asset.mass[i];
      for (double& value : column) value /= std::sqrt(norm);
    }
  }
  asset.floats.resize(std::size_t{n} * r);
  for (std::uint32_t k = 0; k < r; ++k) {
    double largest = 0;
    for (const double value : columns[k]) largest = std::max(largest, std::abs(value));
    for (std::uint32_t i = 0; i < n; ++i) {
      asset.floats[std::size_t{i} * r + k] =
          static_cast<float>(columns[k][i] + noise * largest * (2 * uniform(random) - 1));
    }
  }
  asset.map.resize(n);
  for (std::uint32_t i = 0; i < n; ++i) asset.map[i] = i < asset.base_count ? i : i / 2;
  asset.source_vertex.resize(n);
  std::iota(asset.source_vertex.begin(), asset.source_vertex.end(), 0U);
  std::shuffle(asset.source_vertex.begin(), asset.source_vertex.end(), random);
  return asset;
}

inline std::vector<double> random_values(std::size_t count, unsigned seed = 2) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<double> values(count);
  for (double& value : values) value = normal(random);
  return values;
}

}  // namespace eigencast::testing
