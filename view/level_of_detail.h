// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "common/reconstruction/reconstruct.h"

namespace eigencast {

class LevelOfDetail {
 public:
  static constexpr double kStep = 1.25;  ///< One key press multiplies or divides the fraction by this.
  static constexpr double kMin = 1.0 / 1024;

  /// Clamped to [kMin, 1].
  explicit LevelOfDetail(double fraction = 1) { set_fraction(fraction); }

  void set_fraction(double fraction) { fraction_ = std::isfinite(fraction) ? std::clamp(fraction, kMin, 1.0) : 1.0; }
  double fraction() const { return fraction_; }
  void finer() { set_fraction(fraction_ * kStep); }
  void coarser() { set_fraction(fraction_ / kStep); }

  /// N for this asset: the fraction, within what has arrived; 0 before the base level has.
  std::uint32_t vertices(const Asset& asset) const {
    const bool drawable = asset.rows_ready > 0 && asset.rows_ready >= asset.base_count;
    return drawable ? level_from_fraction(asset, fraction_) : 0;
  }

 private:
  double fraction_ = 1;
};

}  // namespace eigencast
