// SPDX-License-Identifier: MIT
#include "view/texture_levels.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/reconstruction/level_triangles.h"
#include "view/jpeg.h"
#include "view/level_morph.h"
#include "view/surface_geometry.h"

namespace eigencast {
namespace {

constexpr int kLongestSide = 8192;

bool starts_with(const Bytes& bytes, std::initializer_list<std::uint8_t> magic) {
  return bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), bytes.begin());
}

Result<Picture> decode(const Bytes& bytes) {
  const std::string name = "the surface's texture";
  auto picture = starts_with(bytes, {0x89, 'P', 'N', 'G'}) ? read_png_bytes(bytes, name)
                 : starts_with(bytes, {0xff, 0xd8, 0xff})
                     ? read_jpeg_bytes(bytes, name)
                     : Result<Picture>(fail(ErrorCode::kUnsupported, name + " is neither PNG nor JPEG"));
  if (picture && std::max(picture->width, picture->height) > kLongestSide)
    return fail(ErrorCode::kTooLarge, name + " has " + std::to_string(picture->width) + " x " +
                                          std::to_string(picture->height) + " pixels; 8192 a side can be");
  return picture;
}

}  // namespace

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
  places_.resize(texture_->first_wedge[drawn]);
  drawn_ = drawn;
  place_wedges(unmoved, morph);
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

void TextureLevels::place_wedges(std::uint32_t from_vertex, const LevelMorph& morph) {
  for (std::uint32_t v = from_vertex; v < drawn_; ++v) {
    const float weight = morph.weight(v);
    for (std::uint32_t w = texture_->first_wedge[v]; w < texture_->first_wedge[v + 1]; ++w) {
      std::array<float, 2> uv{kNone, kNone};
      if (texture_->places[w] != AssetTexture::kNone) {
        uv = texture_->uv(w);
        const std::array<float, 2>& from = places_.values[texture_->parent[w]];
        for (std::size_t d = 0; d < 2 && weight < 1 && from[0] != kNone; ++d)
          uv[d] = from[d] + weight * (uv[d] - from[d]);
      }
      places_.set(w, uv, version_);
    }
  }
}

Result<std::shared_ptr<const Picture>> image_of(const std::shared_ptr<const AssetTexture>& texture) {
  struct Known {
    std::weak_ptr<const AssetTexture> texture;
    std::weak_ptr<const Picture> picture;
    std::optional<Error> failed;
  };
  static std::mutex mutex;
  static std::map<const AssetTexture*, Known> known;
  const std::lock_guard lock(mutex);
  std::erase_if(known, [](const auto& entry) { return entry.second.texture.expired(); });
  Known& mine = known[texture.get()];
  mine.texture = texture;
  if (mine.failed) return *mine.failed;
  if (auto picture = mine.picture.lock()) return picture;
  auto decoded = decode(texture->image);
  if (!decoded) {
    mine.failed = decoded.error();
    return decoded.error();
  }
  auto picture = std::make_shared<const Picture>(std::move(*decoded));
  mine.picture = picture;
  return picture;
}

}  // namespace eigencast
