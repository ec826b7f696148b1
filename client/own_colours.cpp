// SPDX-License-Identifier: MIT
#include "client/own_colours.h"

#include <array>
#include <cmath>
#include <optional>

#include "view/picture.h"

namespace eigencast {
namespace {

using Colour = std::array<float, 3>;

/// Repeats beyond its sides, as glTF's textures do unless they say otherwise; the nearest pixel.
Colour colour_at(const Picture& texture, const std::array<float, 2>& uv) {
  const auto place = [](float part, int size) {
    const float inside = std::isfinite(part) ? part - std::floor(part) : 0;
    return std::min(static_cast<int>(inside * static_cast<float>(size)), size - 1);
  };
  const std::uint8_t* p = texture.pixel(place(uv[0], texture.width), place(uv[1], texture.height));
  Colour colour{};
  for (std::size_t c = 0; c < 3; ++c) colour[c] = std::pow(static_cast<float>(p[c]) / 255, 2.2F);
  return colour;
}

}  // namespace

std::vector<float> own_colours(const Surface& surface, const Appearance& looks,
                               std::span<const std::uint32_t> source_vertex) {
  std::vector<std::optional<Picture>> textures;
  for (const Appearance::Image& image : looks.images) {
    auto picture = read_png_bytes(image.bytes, image.name);
    textures.push_back(picture ? std::optional<Picture>(std::move(*picture)) : std::nullopt);
  }
  const std::size_t n = surface.positions.size(), F = surface.faces.size();
  const bool has_colours = looks.corner_colour.size() == F, has_materials = looks.face_material.size() == F;
  const bool has_uv = looks.corner_uv.size() == F;
  std::vector<Colour> sum(n, Colour{});
  std::vector<float> corners(n, 0);
  bool any = false;
  for (std::size_t f = 0; f < F; ++f) {
    const Appearance::Material* material = nullptr;
    if (has_materials && looks.face_material[f] >= 0 &&
        static_cast<std::size_t>(looks.face_material[f]) < looks.materials.size())
      material = &looks.materials[static_cast<std::size_t>(looks.face_material[f])];
    const bool textured = has_uv && material != nullptr && material->image >= 0 &&
                          static_cast<std::size_t>(material->image) < textures.size() &&
                          textures[static_cast<std::size_t>(material->image)];
    for (std::size_t k = 0; k < 3; ++k) {
      Colour colour{1, 1, 1};
      for (std::size_t c = 0; c < 3; ++c) {
        if (has_colours) colour[c] *= looks.corner_colour[f][k][c];
        if (material != nullptr) colour[c] *= material->base_colour[c];
      }
      if (textured) {
        const Colour there = colour_at(*textures[static_cast<std::size_t>(material->image)], looks.corner_uv[f][k]);
        for (std::size_t c = 0; c < 3; ++c) colour[c] *= there[c];
      }
      any |= textured || has_colours || colour[0] != colour[1] || colour[1] != colour[2];
      const std::size_t v = surface.faces[f][k];
      for (std::size_t c = 0; c < 3; ++c) sum[v][c] += colour[c];
      corners[v] += 1;
    }
  }
  std::vector<float> colours;
  if (!any || source_vertex.size() != n) return colours;
  colours.reserve(3 * n);
  for (const std::uint32_t v : source_vertex) {
    for (std::size_t c = 0; c < 3; ++c) colours.push_back(corners[v] > 0 ? sum[v][c] / corners[v] : 0.5F);
  }
  return colours;
}

}  // namespace eigencast
