// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace eigencast {

/// How a surface looks, as its file states it. Corners, because one vertex may have several texture coordinates where
/// the file has a seam. Empty arrays: not stated.
struct Appearance {
  struct Image {
    std::string name;
    std::string mime_type;            ///< "image/png", "image/jpeg", or what the file says.
    std::vector<std::uint8_t> bytes;  ///< Encoded, as stored; never decoded here.
  };
  struct Material {
    std::string name;
    std::array<float, 4> base_colour{1, 1, 1, 1};  ///< Linear RGBA factor.
    int image = -1;                                ///< Of the base colour; -1: none.
  };
  std::vector<std::array<std::uint8_t, 3>> vertex_colour;          ///< n: sRGB.
  std::vector<std::array<std::array<float, 2>, 3>> corner_uv;      ///< F x 3: first set of texture coordinates.
  std::vector<std::array<std::array<float, 4>, 3>> corner_colour;  ///< F x 3: linear RGBA.
  std::vector<int> face_material;                                  ///< F; -1: none.
  std::vector<Material> materials;
  std::vector<Image> images;
};

}  // namespace eigencast
