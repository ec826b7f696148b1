// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/asset/texture.h"
#include "common/core/result.h"
#include "common/progressive/wedges.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// The image that an asset is to have, and where the corners of the source's faces lie in it.
struct TexturePlan {
  std::array<float, 2> low{}, high{};
  std::vector<CornerUvs> uvs;  ///< A face each.
  Bytes image;
};

/// Why an asset cannot have an image (that is whole): too large, or neither PNG nor JPEG.
Result<void> check_image(const Appearance::Image& image);

/// Of a surface's images the one that most faces have; nothing where there is none that an asset can have. `report`
/// gets lines for people: which it is, and what was left out and why.
std::optional<TexturePlan> plan_texture(const Surface& surface, const Appearance& appearance, std::string& report);

/// REQUIRES: the order is of the plan's surface.
std::shared_ptr<const AssetTexture> texture_along(const PrefixOrder& order, const TexturePlan& plan);

}  // namespace eigencast
