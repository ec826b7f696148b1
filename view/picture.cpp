// SPDX-License-Identifier: MIT
#include "view/picture.h"

#include <png.h>

#include <cstdio>
#include <filesystem>
#include <system_error>

namespace eigencast {
namespace {

constexpr int kLongestSide = 16'384;

}  // namespace

Result<void> write_png(const std::string& path, const Picture& picture) {
  if (picture.width <= 0 || picture.height <= 0 ||
      picture.rgb.size() != 3 * static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height)) {
    return fail(ErrorCode::kInvalidArgument, path + ": the picture's size and its pixels do not agree");
  }
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(picture.width);
  image.height = static_cast<png_uint_32>(picture.height);
  image.format = PNG_FORMAT_RGB;
  image.flags = PNG_IMAGE_FLAG_FAST;
  const std::string partial = path + ".partial";
  if (png_image_write_to_file(&image, partial.c_str(), 0, picture.rgb.data(), 0, nullptr) == 0) {
    const std::string why = image.message;
    std::remove(partial.c_str());
    return fail(ErrorCode::kIo, path + ": cannot write the picture (" + why + "); is the folder there and writable?");
  }
  std::error_code error;
  std::filesystem::rename(partial, path, error);
  if (error) return fail(ErrorCode::kIo, path + ": " + error.message());
  return {};
}

Result<Picture> read_png(const std::string& path) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_file(&image, path.c_str()) == 0) {
    std::error_code error;
    return fail(std::filesystem::exists(path, error) ? ErrorCode::kCorrupt : ErrorCode::kIo,
                path + ": " + image.message);
  }
  if (image.width > kLongestSide || image.height > kLongestSide) {
    png_image_free(&image);
    return fail(ErrorCode::kTooLarge, path + ": over 16,384 pixels on a side");
  }
  image.format = PNG_FORMAT_RGB;
  Picture picture;
  picture.width = static_cast<int>(image.width);
  picture.height = static_cast<int>(image.height);
  picture.rgb.resize(PNG_IMAGE_SIZE(image));
  if (png_image_finish_read(&image, nullptr, picture.rgb.data(), 0, nullptr) == 0) {
    return fail(ErrorCode::kCorrupt, path + ": " + image.message);
  }
  return picture;
}

}  // namespace eigencast
