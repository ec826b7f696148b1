// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "view/picture.h"

namespace eigencast {

/// A texture's image: neither picture nor error while it is being decoded.
struct TextureImage {
  std::shared_ptr<const Picture> picture;
  std::optional<Error> failed;
};

/// kBackground: one thread decodes, and callers ask again. At most kMaxImagesWaiting wait for it: others are queued
/// when they are asked for again.
enum class Decode { kNow, kBackground };
inline constexpr std::size_t kMaxImagesWaiting = 8;

inline constexpr int kMaxTextureSide = 8192;  ///< Images are halved until no side is longer.

/// Callers share it while one of them holds it. max_side: the GPU's limit, where that is below kMaxTextureSide.
/// Thread-safe. Errors: kCorrupt, kUnsupported (neither PNG nor JPEG), kTooLarge (kMaxPixels, received_memory()).
TextureImage image_of(const std::shared_ptr<const AssetTexture>& texture, Decode decode,
                      int max_side = kMaxTextureSide);

/// A quarter of the pixels, each the mean of four in nearly linear light (of their squares). REQUIRES: two pixels a
/// side or more.
Picture halved(const Picture& picture);

}  // namespace eigencast
