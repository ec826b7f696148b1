// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>

#include "common/asset/texture.h"
#include "common/core/result.h"
#include "view/picture.h"

namespace eigencast {

/// What has become of a texture's image: neither picture nor error while it is being decoded.
struct TextureImage {
  std::shared_ptr<const Picture> picture;
  std::optional<Error> failed;
};

/// Who decodes: the caller, who has it at once; or a thread beside it, and the caller asks again. There is one such
/// thread, and no more than kMaxImagesWaiting wait for it: others are taken up when they are asked for again.
enum class Decode { kNow, kBeside };
inline constexpr std::size_t kMaxImagesWaiting = 8;

inline constexpr int kMaxTextureSide = 8192;  ///< Images are halved until no side is longer.

/// The image of a texture; the same one for all who ask while somebody has it. longest_side: of what the GPU
/// takes, where that is less than kMaxTextureSide. Thread-safe. Errors: kCorrupt, kUnsupported (neither PNG nor
/// JPEG), kTooLarge (kMaxPixels).
TextureImage image_of(const std::shared_ptr<const AssetTexture>& texture, Decode decode,
                      int longest_side = kMaxTextureSide);

/// A quarter of the pixels, each the mean of four in linear light (nearly: of their squares). REQUIRES: two pixels a
/// side or more.
Picture halved(const Picture& picture);

}  // namespace eigencast
