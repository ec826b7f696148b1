// SPDX-License-Identifier: MIT
#include "sdk/bake_parts.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace eigencast {
namespace {

/// Coordinates beyond this are not UVs.
constexpr float kFarthest = 1e6F;

static_assert(kMaxImageBytes == AssetTexture::kMaxImageBytes);

/// Indexes appearance.images; -1: none.
int image_of(const Appearance& appearance, std::size_t face) {
  if (appearance.face_material.size() <= face) return appearance.images.size() == 1 ? 0 : -1;
  const int material = appearance.face_material[face];
  if (material < 0 || static_cast<std::size_t>(material) >= appearance.materials.size()) return -1;
  const int image = appearance.materials[static_cast<std::size_t>(material)].image;
  return static_cast<std::size_t>(image) < appearance.images.size() ? image : -1;
}

bool in_image(const std::array<std::array<float, 2>, 3>& corners) {
  return std::all_of(corners.begin(), corners.end(),
                     [](const auto& uv) { return std::abs(uv[0]) <= kFarthest && std::abs(uv[1]) <= kFarthest; });
}

}  // namespace

std::optional<TexturePlan> plan_texture(const Surface& surface, const Appearance& appearance, std::string& report) {
  const std::size_t F = surface.faces.size();
  if (appearance.corner_uv.size() != F || F == 0 || appearance.images.empty()) return std::nullopt;
  std::vector<std::size_t> faces_of(appearance.images.size(), 0);
  for (std::size_t f = 0; f < F; ++f) {
    const int image = image_of(appearance, f);
    if (image >= 0 && in_image(appearance.corner_uv[f])) ++faces_of[static_cast<std::size_t>(image)];
  }
  std::size_t chosen = appearance.images.size(), others = 0;
  for (std::size_t i = 0; i < appearance.images.size(); ++i) {
    if (faces_of[i] == 0) continue;
    if (const auto usable = check_image(appearance.images[i]); !usable) {
      report += "texture: left out, " + usable.error().message + "\n";
    } else if (chosen == appearance.images.size() || faces_of[i] > faces_of[chosen]) {
      others += chosen == appearance.images.size() ? 0 : 1;
      chosen = i;
    } else {
      ++others;
    }
  }
  if (chosen == appearance.images.size()) return std::nullopt;
  TexturePlan plan;
  plan.image = appearance.images[chosen].bytes;
  const auto wanted = [&](std::size_t f) {
    return image_of(appearance, f) == static_cast<int>(chosen) && in_image(appearance.corner_uv[f]);
  };
  plan.low.fill(std::numeric_limits<float>::max());
  plan.high.fill(-std::numeric_limits<float>::max());
  for (std::size_t f = 0; f < F; ++f) {
    if (!wanted(f)) continue;
    for (const auto& uv : appearance.corner_uv[f]) {
      for (std::size_t d = 0; d < 2; ++d) {
        plan.low[d] = std::min(plan.low[d], uv[d]);
        plan.high[d] = std::max(plan.high[d], uv[d]);
      }
    }
  }
  plan.uvs.assign(F, {AssetTexture::kNone, AssetTexture::kNone, AssetTexture::kNone});
  for (std::size_t f = 0; f < F; ++f) {
    for (std::size_t k = 0; k < 3 && wanted(f); ++k) {
      for (std::size_t d = 0; d < 2; ++d)
        plan.uvs[f][k][d] = texture_grid(appearance.corner_uv[f][k][d], plan.low[d], plan.high[d]);
    }
  }
  report += "texture: image \"" + appearance.images[chosen].name + "\", " + std::to_string(plan.image.size() / 1024) +
            " KiB, on " + std::to_string(faces_of[chosen]) + " of " + std::to_string(F) + " faces";
  if (others > 0) report += "; an asset has one, the other " + std::to_string(others) + " are left out";
  report += "\n";
  return plan;
}

std::shared_ptr<const AssetTexture> texture_along(const PrefixOrder& order, const TexturePlan& plan) {
  WedgeOrder wedges = build_wedges(order, plan.uvs);
  AssetTexture texture;
  texture.first_wedge = std::move(wedges.first_wedge);
  texture.uvs = std::move(wedges.uvs);
  texture.parent = std::move(wedges.parent);
  texture.corners = std::move(wedges.corners);
  texture.low = plan.low;
  texture.high = plan.high;
  texture.image = plan.image;
  return std::make_shared<const AssetTexture>(std::move(texture));
}

}  // namespace eigencast
