// SPDX-License-Identifier: MIT
#include "view/level_of_detail.h"

#include <algorithm>
#include <cmath>

#include "common/reconstruction/reconstruct.h"

namespace eigencast {

LevelOfDetail::LevelOfDetail(double fraction) {
  set_fraction(fraction);
}

void LevelOfDetail::set_fraction(double fraction) {
  fraction_ = std::isfinite(fraction) ? std::clamp(fraction, kMin, 1.0) : 1.0;
}

std::uint32_t LevelOfDetail::vertices(const Asset& asset) const {
  if (asset.rows_ready == 0 || asset.rows_ready < asset.base_count) return 0;
  return level_from_fraction(asset, fraction_);
}

}  // namespace eigencast
