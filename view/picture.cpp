// SPDX-License-Identifier: MIT
#include "view/picture.h"

#include <png.h>

#include <cstdio>
#include <filesystem>
#include <system_error>

namespace eigencast {
namespace {

std::vector<std::uint8_t> rgba_of(const Picture& picture) {
  std::vector<std::uint8_t> rgba;
  rgba.reserve(4 * picture.alpha.size());
  for (std::size_t i = 0; i < picture.alpha.size(); ++i)
    rgba.insert(rgba.end(), {picture.rgb[3 * i], picture.rgb[3 * i + 1], picture.rgb[3 * i + 2], picture.alpha[i]});
  return rgba;
}

}  // namespace

Result<void> write_png(const std::string& path, const Picture& picture) {
  const std::size_t pixels = static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height);
  if (picture.width <= 0 || picture.height <= 0 || picture.rgb.size() != 3 * pixels ||
      (!picture.alpha.empty() && picture.alpha.size() != pixels)) {
    return fail(ErrorCode::kInvalidArgument, path + ": the picture's size and its pixels do not agree");
  }
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(picture.width);
  image.height = static_cast<png_uint_32>(picture.height);
  image.format = picture.alpha.empty() ? PNG_FORMAT_RGB : PNG_FORMAT_RGBA;
  image.flags = PNG_IMAGE_FLAG_FAST;
  const std::vector<std::uint8_t> with_alpha = picture.alpha.empty() ? std::vector<std::uint8_t>() : rgba_of(picture);
  const std::uint8_t* bytes = picture.alpha.empty() ? picture.rgb.data() : with_alpha.data();
  const std::string partial = path + ".partial";
  if (png_image_write_to_file(&image, partial.c_str(), 0, bytes, 0, nullptr) == 0) {
    const std::string why = image.message;
    std::remove(partial.c_str());
    return fail(ErrorCode::kIo, path + ": cannot write the picture (" + why + "); is the folder there and writable?");
  }
  std::error_code error;
  std::filesystem::rename(partial, path, error);
  if (error) return fail(ErrorCode::kIo, path + ": " + error.message());
  return {};
}

Result<Picture> read_png_bytes(std::span<const std::uint8_t> bytes, const std::string& name) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_memory(&image, bytes.data(), bytes.size()) == 0)
    return fail(ErrorCode::kCorrupt, name + ": " + image.message);
  if (image.width > kMaxSide || image.height > kMaxSide || std::size_t{image.width} * image.height > kMaxPixels) {
    png_image_free(&image);
    return fail(ErrorCode::kTooLarge, name + ": over 16,384 pixels on a side, or 134 million");
  }
  image.format = PNG_FORMAT_RGB;
  Picture picture;
  picture.width = static_cast<int>(image.width);
  picture.height = static_cast<int>(image.height);
  picture.rgb.resize(PNG_IMAGE_SIZE(image));
  if (png_image_finish_read(&image, nullptr, picture.rgb.data(), 0, nullptr) == 0)
    return fail(ErrorCode::kCorrupt, name + ": " + image.message);
  return picture;
}

}  // namespace eigencast
