// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast::bench {

/// How large coefficient k gets beside the first, in the clips that were measured (sdk/bake.cpp).
inline double amplitude(std::uint32_t k) {
  return std::pow(k + 1.0, -1.2);
}

/// An asset on a grid but for four columns, as bakes are at their default error; its shape means nothing.
inline Asset random_asset(std::uint32_t n, std::uint32_t r, bool on_grid) {
  Asset asset;
  asset.vertex_count = asset.rows_ready = n;
  asset.rank = r;
  std::mt19937 random(1);
  const std::uint32_t float_columns = on_grid ? std::min(r, 4U) : r;
  std::vector<float> scales;
  for (std::uint32_t k = 0; k < r; ++k) scales.push_back(static_cast<float>(1 / (8000 * amplitude(k))));
  asset.column_scales.assign(scales.begin() + float_columns, scales.end());
  std::normal_distribution<float> entries;
  for (std::size_t i = 0; i < std::size_t{n} * r; ++i) {
    const float scale = scales[i % r];
    const float integer = std::clamp(std::nearbyint(entries(random) / scale), -32767.0F, 32767.0F);
    if (i % r < float_columns) {
      asset.floats.push_back(integer * scale);
    } else {
      asset.integers.push_back(static_cast<std::int16_t>(integer));
    }
  }
  asset.mass.assign(n, 1.0F);
  asset.source_vertex.resize(n);
  for (std::uint32_t i = 0; i < n; ++i) asset.source_vertex[i] = i;
  return asset;
}

/// Coefficients of a pose of it, r x 3.
inline std::vector<double> random_coefficients(std::uint32_t r) {
  std::vector<double> C;
  std::mt19937 random(2);
  for (std::uint32_t i = 0; i < 3 * r; ++i) {
    C.push_back((static_cast<double>(random()) / 4294967296.0 - 0.5) * amplitude(i / 3));
  }
  return C;
}

}  // namespace eigencast::bench
