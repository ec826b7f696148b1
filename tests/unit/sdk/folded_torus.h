// SPDX-License-Identifier: MIT
#pragma once

#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"

/// A torus in waves, which its basis holds, and bumps, which a few columns hold.
namespace eigencast {

struct FoldedTorus {
  Surface rest;
  std::shared_ptr<const Asset> asset;
  std::shared_ptr<const EncodedAsset> encoded;
};

inline const FoldedTorus& folded_torus() {
  static const FoldedTorus torus = [] {
    FoldedTorus made;
    made.rest = make_torus(60, 30, 1, 0.4);
    auto baked = bake(made.rest, {.rank = 30, .name = {}});
    made.asset = std::make_shared<const Asset>(std::move(baked->asset));
    made.encoded = std::make_shared<const EncodedAsset>(std::move(baked->encoded));
    return made;
  }();
  return torus;
}

/// n x 3; both about a tenth of the torus at 1.
inline std::vector<float> torus_pose(std::size_t number, double bumps, double waves = 1) {
  std::vector<float> positions;
  const double t = 0.3 * static_cast<double>(number);
  for (const Vec3& p : folded_torus().rest.positions) {
    const double around = std::atan2(p[2], p[0]);
    const double bump = 0.1 * bumps * (std::sin(t) * std::cos(23 * around) + std::cos(1.7 * t) * std::sin(29 * around));
    double wave = 0;
    for (const int m : {1, 2, 3}) wave += 0.1 * waves * std::sin(2.3 * m * m * t + m) * std::cos(m * around);
    for (const double x : {p[0] + wave, p[1] + wave * p[0] + bump, p[2] - wave})
      positions.push_back(static_cast<float>(x));
  }
  return positions;
}

/// Of each vertex (rms) between a pose of the source and one of an asset.
inline double rms_error(const Asset& asset, const std::vector<float>& truth, std::span<const double> C) {
  std::vector<float> rows(truth.size());
  positions_from_coefficients(asset, C, 3, asset.rank, asset.vertex_count, rows);
  double squares = 0;
  for (std::size_t row = 0; row < asset.vertex_count; ++row) {
    for (std::size_t d = 0; d < 3; ++d)
      squares += std::pow(truth[3 * asset.source_vertex[row] + d] - asset.origin[d] - rows[3 * row + d], 2);
  }
  return std::sqrt(squares / asset.vertex_count);
}

}  // namespace eigencast
