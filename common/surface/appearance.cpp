// SPDX-License-Identifier: MIT
#include "common/surface/appearance.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <set>

#include "common/core/text.h"

namespace eigencast {
namespace {

using Light = std::array<float, 3>;

std::array<std::uint8_t, 3> bytes_from(const Light& light) {
  std::array<std::uint8_t, 3> bytes{};
  for (std::size_t c = 0; c < 3; ++c) {
    const float part = std::isfinite(light[c]) ? std::clamp(light[c], 0.0F, 1.0F) : 0.5F;
    bytes[c] = static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(part)));
  }
  return bytes;
}

const Appearance::Material* material_of(const Appearance& appearance, std::size_t face) {
  if (face >= appearance.face_material.size() || appearance.face_material[face] < 0) return nullptr;
  const auto number = static_cast<std::size_t>(appearance.face_material[face]);
  return number < appearance.materials.size() ? &appearance.materials[number] : nullptr;
}

}  // namespace

std::string quoted_name(std::string_view name) {
  constexpr std::size_t kShown = 100;
  return '"' + escaped(name.substr(0, kShown)) + (name.size() > kShown ? "...\"" : "\"");
}

Result<void> check_image(const Appearance::Image& image) {
  const auto starts_with = [&](std::initializer_list<std::uint8_t> magic) {
    return image.bytes.size() >= magic.size() && std::equal(magic.begin(), magic.end(), image.bytes.begin());
  };
  const std::string what = "image " + quoted_name(image.name) + " ";
  if (image.bytes.empty()) return fail(ErrorCode::kNotFound, what + "is empty or could not be read");
  if (image.bytes.size() > kMaxImageBytes) return fail(ErrorCode::kTooLarge, what + "has more than 16 MiB");
  if (!starts_with({0x89, 'P', 'N', 'G'}) && !starts_with({0xff, 0xd8, 0xff}))
    return fail(ErrorCode::kUnsupported, what + "is neither PNG nor JPEG");
  return {};
}

void note_other_images(Appearance& appearance) {
  std::set<int> images;
  for (std::size_t f = 0; f < appearance.face_material.size(); ++f) {
    const Appearance::Material* material = material_of(appearance, f);
    if (material != nullptr && material->image >= 0) images.insert(material->image);
  }
  if (images.size() > 1)
    appearance.missing.push_back("of " + std::to_string(images.size()) +
                                 " images the one that most faces have is used: the others' faces are drawn without");
}

float linear_from_srgb(float part) {
  return part <= 0.04045F ? part / 12.92F : std::pow((part + 0.055F) / 1.055F, 2.4F);
}
float srgb_from_linear(float part) {
  return part <= 0.0031308F ? 12.92F * part : 1.055F * std::pow(part, 1 / 2.4F) - 0.055F;
}

std::vector<std::array<std::uint8_t, 3>> stated_colours(const Surface& surface, const Appearance& appearance) {
  const std::size_t n = surface.positions.size(), F = surface.faces.size();
  if (appearance.vertex_colour.size() == n) return appearance.vertex_colour;
  const bool has_corners = appearance.corner_colour.size() == F && F > 0;
  std::vector<Light> sum(n, Light{});
  std::vector<float> corners(n, 0);
  for (std::size_t f = 0; f < F; ++f) {
    const Appearance::Material* material = material_of(appearance, f);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t v = surface.faces[f][k];
      for (std::size_t c = 0; c < 3; ++c) {
        sum[v][c] += (has_corners ? appearance.corner_colour[f][k][c] : 1) *
                     (material != nullptr ? material->base_colour[c] : 1);
      }
      corners[v] += 1;
    }
  }
  std::vector<std::array<std::uint8_t, 3>> colours;
  bool any = false;
  for (std::size_t v = 0; v < n; ++v) {
    Light mean{1, 1, 1};
    for (std::size_t c = 0; c < 3 && corners[v] > 0; ++c) mean[c] = sum[v][c] / corners[v];
    colours.push_back(bytes_from(mean));
    const auto& rgb = colours.back();
    any |= rgb[0] != rgb[1] || rgb[1] != rgb[2] || rgb != colours.front();
  }
  if (!any) colours.clear();
  return colours;
}

}  // namespace eigencast
