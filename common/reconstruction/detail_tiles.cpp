// SPDX-License-Identifier: MIT
#include "common/reconstruction/detail_tiles.h"

#include <algorithm>
#include <cassert>

#include "common/asset/detail.h"

namespace eigencast {

void DetailTiles::update(const Asset& asset) {
  const Asset::Detail& detail = asset.detail;
  if (detail.size() < asset.rows_ready || detail.size() == 0) {
    *this = {};
    return;
  }
  along_x_.update(detail.along_x, detail.steps, asset.rows_ready);
  along_y_.update(detail.along_y, detail.steps, asset.rows_ready);
  const auto known = static_cast<std::ptrdiff_t>(offset_.size());
  offset_.insert(offset_.end(), detail.offset.begin() + known, detail.offset.begin() + asset.rows_ready);
  normal_.insert(normal_.end(), detail.normal.begin() + known, detail.normal.begin() + asset.rows_ready);
}

void DetailTiles::add(std::uint32_t first, std::span<const float> along_x, std::span<const float> along_y,
                      std::span<float> positions, std::span<float> normals) const {
  using Vector = std::array<float, 3>;
  const auto vector_at = [](std::span<const float> values, std::size_t i) {
    return Vector{values[i], values[i + 1], values[i + 2]};
  };
  assert(along_x.size() == along_y.size() && positions.size() >= along_x.size());
  for (std::size_t i = 0; i < along_x.size(); i += 3) {
    const std::size_t row = first + i / 3;
    const auto frame = frame_from_derivatives(vector_at(along_x, i), vector_at(along_y, i));
    const Vector offset = frame.from_frame(offset_[row]);
    for (std::size_t d = 0; d < 3; ++d) positions[i + d] += offset[d];
    if (normals.empty()) continue;
    const Vector normal = frame.from_frame(normal_[row]);
    std::copy(normal.begin(), normal.end(), normals.begin() + static_cast<std::ptrdiff_t>(i));
  }
}

}  // namespace eigencast
