// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Whether the corners that share a vertex have one normal in their file, so that it is smooth there, or several: its
/// edges are hard. kNone: a corner has none. Values are those of Asset::normals.
enum class VertexNormals : std::uint8_t { kNone, kAgree, kDiffer };

/// Colours and textures of a surface, as its file states them. By corner where a seam gives one vertex several texture
/// coordinates. Empty arrays: not stated.
struct Appearance {
  struct Image {
    std::string name;
    std::string mime_type;            ///< "image/png", "image/jpeg", or what the file says.
    std::vector<std::uint8_t> bytes;  ///< Encoded, as stored; never decoded here. Empty: could not be read.
  };
  struct Material {
    std::string name;
    std::array<float, 4> base_colour{1, 1, 1, 1};  ///< Linear RGBA factor.
    int image = -1;                                ///< Has the base colour; -1: none.
  };
  std::vector<std::array<std::uint8_t, 3>> vertex_colour;          ///< n: sRGB.
  std::vector<VertexNormals> vertex_normals;                       ///< n.
  std::vector<std::array<std::array<float, 2>, 3>> corner_uv;      ///< F x 3: first set of texture coordinates.
  std::vector<std::array<std::array<float, 4>, 3>> corner_colour;  ///< F x 3: linear RGBA.
  std::vector<int> face_material;                                  ///< F; -1: none.
  std::vector<Material> materials;
  std::vector<Image> images;
  std::vector<std::string> missing;  ///< Files it names that cannot be used, and what follows: a warning each.
};

/// Why an asset cannot have an image (that is whole): empty, over kMaxImageBytes, or neither PNG nor JPEG.
Result<void> check_image(const Appearance::Image& image);
inline constexpr std::size_t kMaxImageBytes = std::size_t{16} << 20;

/// Adds to `missing` where faces have several images: an asset has one.
void note_other_images(Appearance& appearance);

/// A file's name for a message: quoted, its control characters escaped, and at most 100 bytes of it.
std::string quoted_name(std::string_view name);

/// One colour for each vertex, sRGB: its own, or the mean (of light) over its corners of the corner's colour times its
/// material's. Textures do not count. Empty where the file states no colours, or one grey alone.
std::vector<std::array<std::uint8_t, 3>> stated_colours(const Surface& surface, const Appearance& appearance);

/// The transfer function of sRGB (IEC 61966-2-1), of 0 to 1.
float linear_from_srgb(float part);
float srgb_from_linear(float part);

}  // namespace eigencast
