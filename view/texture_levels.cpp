// SPDX-License-Identifier: MIT
#include "view/texture_levels.h"

#include <algorithm>
#include <atomic>
#include <utility>

#include "common/reconstruction/level_morph.h"
#include "common/reconstruction/level_triangles.h"
#include "view/rebuild.h"

namespace eigencast {

void TextureLevels::follow(std::shared_ptr<const AssetTexture> texture, const SurfaceGeometry& geometry,
                           const LevelMorph& morph) {
  static std::atomic<std::uint64_t> made{0};
  version_ = ++made;
  if (std::exchange(maker_, geometry.maker) != geometry.maker || texture_ != texture) {
    texture_ = std::move(texture);
    topology_version_ = 0;
    whole_ = drawn_ = 0;
  }
  const std::uint32_t unmoved = std::min(whole_, morph.whole());
  const std::uint32_t drawn = std::min(morph.drawn(), vertex_count());
  uvs_.resize(texture_->first_wedge[drawn]);
  drawn_ = drawn;
  set_wedges(unmoved, morph);
  whole_ = std::min(morph.whole(), drawn_);

  const std::uint64_t had = std::exchange(topology_version_, geometry.topology_version);
  if (had == geometry.topology_version) return;
  const std::size_t count = std::min(geometry.triangles.size(), 3 * texture_->corners.size());
  corners_.resize(count);
  const std::uint32_t end = texture_->first_wedge[drawn_];
  constexpr std::size_t kBlock = LevelTriangles::kBlock;
  for (std::size_t begin = 0; begin < count; begin += kBlock) {
    const std::size_t block = begin / kBlock;
    if (had != 0 && block < geometry.triangle_blocks.size() && geometry.triangle_blocks[block] <= had) continue;
    for (std::size_t slot = begin; slot < std::min(begin + kBlock, count); ++slot) {
      std::uint32_t wedge = texture_->corners[slot / 3][slot % 3];
      while (wedge >= end) wedge = texture_->parent[wedge];
      corners_.set(slot, wedge, version_);
    }
  }
}

void TextureLevels::set_wedges(std::uint32_t from_vertex, const LevelMorph& morph) {
  for (std::uint32_t v = from_vertex; v < drawn_; ++v) {
    const float weight = morph.weight(v);
    for (std::uint32_t w = texture_->first_wedge[v]; w < texture_->first_wedge[v + 1]; ++w) {
      std::array<float, 2> uv{kNone, kNone};
      if (texture_->uvs[w] != AssetTexture::kNone) {
        uv = texture_->uv(w);
        const std::array<float, 2>& from = uvs_.values[texture_->parent[w]];
        for (std::size_t d = 0; d < 2 && weight < 1 && from[0] != kNone; ++d)
          uv[d] = from[d] + weight * (uv[d] - from[d]);
      }
      uvs_.set(w, uv, version_);
    }
  }
}

}  // namespace eigencast
