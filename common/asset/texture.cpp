// SPDX-License-Identifier: MIT
#include "common/asset/texture.h"

#include <cmath>

namespace eigencast {

namespace {

constexpr float kGridSteps = 65534;

}  // namespace

std::array<float, 2> AssetTexture::uv(std::uint32_t wedge) const {
  std::array<float, 2> at{};
  for (std::size_t d = 0; d < 2; ++d)
    at[d] = low[d] + (high[d] - low[d]) * (static_cast<float>(uvs[wedge][d]) / kGridSteps);
  return at;
}

std::uint16_t texture_grid(float value, float low, float high) {
  return high > low ? static_cast<std::uint16_t>(std::lround(kGridSteps * ((value - low) / (high - low)))) : 0;
}

bool AssetTexture::has_finite_box() const {
  const auto is_small = [](float value) { return std::abs(value) <= 1e30F; };
  return is_small(low[0]) && is_small(low[1]) && is_small(high[0]) && is_small(high[1]) && low[0] <= high[0] &&
         low[1] <= high[1];
}

}  // namespace eigencast
