// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "common/reconstruction/basis_tiles.h"

namespace eigencast::testing {

/// By how much rounding a pose's coefficients to 16 bits (BasisTiles::whole_coefficients) may move a vertex: half a
/// unit for each of its row's integers, no more. Nothing where they are not rounded.
class CoefficientRounding {
 public:
  /// asset and tiles: of one basis, kept by the caller. C: r x channels, row-major, multiplied as far as `rank`.
  CoefficientRounding(const Asset& asset, const BasisTiles& tiles, std::span<const double> C, std::uint32_t channels,
                      std::uint32_t rank)
      : asset_(asset), rank_(rank), whole_(tiles.whole_coefficients(C, channels, rank)) {}

  /// Bounds each axis of row i.
  std::array<double, 3> of(std::size_t i) const {
    std::array<double, 3> rounding{};
    if (!whole_) return rounding;
    for (std::size_t k = asset_.float_columns(); k < rank_; ++k) {
      const double integer = asset_.integers[i * asset_.column_scales.size() + k - asset_.float_columns()];
      for (std::size_t d = 0; d < 3; ++d) rounding[d] += 0.5 * double{whole_->unit[d]} * std::abs(integer);
    }
    return rounding;
  }

 private:
  const Asset& asset_;
  std::uint32_t rank_;
  std::optional<WholeCoefficients> whole_;
};

}  // namespace eigencast::testing
