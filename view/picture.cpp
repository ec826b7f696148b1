// SPDX-License-Identifier: MIT
#include "view/picture.h"

#include <png.h>

#include <array>
#include <csetjmp>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <system_error>
// After cstdio, which it needs.
#include <jpeglib.h>

namespace eigencast {
namespace {

std::vector<std::uint8_t> rgba_of(const Picture& picture) {
  std::vector<std::uint8_t> rgba;
  rgba.reserve(4 * picture.alpha.size());
  for (std::size_t i = 0; i < picture.alpha.size(); ++i)
    rgba.insert(rgba.end(), {picture.rgb[3 * i], picture.rgb[3 * i + 1], picture.rgb[3 * i + 2], picture.alpha[i]});
  return rgba;
}

constexpr int kMaxScans = 200;

enum Exit : int { kBroken = 1, kEndless = 2 };

/// libjpeg calls exit() on errors, unless a handler jumps out of it.
struct DecoderState {
  jpeg_error_mgr manager;
  jpeg_progress_mgr progress;
  std::jmp_buf exit;
  std::array<char, JMSG_LENGTH_MAX> message;
};

void on_error(j_common_ptr image) {
  auto* state = reinterpret_cast<DecoderState*>(image->err);
  image->err->format_message(image, state->message.data());
  std::longjmp(state->exit, kBroken);
}
void ignore_message(j_common_ptr, int) {}
/// A small file may hold any number of scans.
void count_scans(j_common_ptr image) {
  if (reinterpret_cast<j_decompress_ptr>(image)->input_scan_number > kMaxScans)
    std::longjmp(reinterpret_cast<DecoderState*>(image->err)->exit, kEndless);
}

std::string millions(std::size_t pixels) {
  return std::to_string(pixels / 1'000'000) + " million in all (of 134, or what memory allows)";
}

struct Destroyer {
  jpeg_decompress_struct& image;
  ~Destroyer() { jpeg_destroy_decompress(&image); }
};

/// Holds nothing that needs destruction: errors jump over it.
std::optional<ErrorCode> decode(std::span<const std::uint8_t> bytes, jpeg_decompress_struct& image, DecoderState& state,
                                std::size_t max_pixels, Picture& picture) {
  if (const int exit = setjmp(state.exit); exit != 0)
    return exit == kEndless ? ErrorCode::kTooLarge : ErrorCode::kCorrupt;
  jpeg_create_decompress(&image);
  jpeg_mem_src(&image, bytes.data(), static_cast<unsigned long>(bytes.size()));
  jpeg_read_header(&image, TRUE);
  if (image.image_width > kMaxSide || image.image_height > kMaxSide ||
      std::size_t{image.image_width} * image.image_height > max_pixels)
    return ErrorCode::kTooLarge;
  if (image.jpeg_color_space == JCS_CMYK || image.jpeg_color_space == JCS_YCCK) return ErrorCode::kUnsupported;
  image.out_color_space = JCS_RGB;
  image.progress = &state.progress;
  jpeg_start_decompress(&image);
  picture.width = static_cast<int>(image.output_width);
  picture.height = static_cast<int>(image.output_height);
  picture.rgb.resize(std::size_t{3} * image.output_width * image.output_height);
  while (image.output_scanline < image.output_height) {
    JSAMPROW row = picture.rgb.data() + std::size_t{3} * image.output_width * image.output_scanline;
    jpeg_read_scanlines(&image, &row, 1);
  }
  jpeg_finish_decompress(&image);
  return std::nullopt;
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

Result<Picture> read_png_bytes(std::span<const std::uint8_t> bytes, const std::string& name, std::size_t max_pixels) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_memory(&image, bytes.data(), bytes.size()) == 0)
    return fail(ErrorCode::kCorrupt, name + ": " + image.message);
  if (image.width > kMaxSide || image.height > kMaxSide || std::size_t{image.width} * image.height > max_pixels) {
    png_image_free(&image);
    return fail(ErrorCode::kTooLarge, name + ": over 16,384 pixels on a side, or " + millions(max_pixels));
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

Result<Picture> read_jpeg_bytes(std::span<const std::uint8_t> bytes, const std::string& name, std::size_t max_pixels) {
  jpeg_decompress_struct image{};
  DecoderState state{};
  image.err = jpeg_std_error(&state.manager);
  state.manager.error_exit = on_error;
  state.manager.emit_message = ignore_message;
  state.progress.progress_monitor = count_scans;
  Picture picture;
  const Destroyer destroyer{image};
  const std::optional<ErrorCode> failed = decode(bytes, image, state, max_pixels, picture);
  if (!failed) return picture;
  if (failed == ErrorCode::kTooLarge)
    return fail(*failed, name + ": over 16,384 pixels on a side, " + millions(max_pixels) + ", or 200 scans");
  if (failed == ErrorCode::kUnsupported)
    return fail(*failed, name + ": a JPEG in colours of print (CMYK); save it in RGB");
  return fail(ErrorCode::kCorrupt, name + ": " + state.message.data());
}

}  // namespace eigencast
