// SPDX-License-Identifier: MIT
#include "view/jpeg.h"

#include <array>
#include <csetjmp>
#include <cstddef>
#include <cstdio>
// After cstdio, which it needs.
#include <jpeglib.h>

namespace eigencast {
namespace {

constexpr int kMaxSide = 16'384, kMaxScans = 200;

enum WayOut : int { kBroken = 1, kEndless = 2 };

/// libjpeg's way out of an error, which would end the program otherwise.
struct Trouble {
  jpeg_error_mgr manager;
  jpeg_progress_mgr progress;
  std::jmp_buf way_out;
  std::array<char, JMSG_LENGTH_MAX> words;
};

void leave(j_common_ptr image) {
  auto* trouble = reinterpret_cast<Trouble*>(image->err);
  image->err->format_message(image, trouble->words.data());
  std::longjmp(trouble->way_out, kBroken);
}
void say_nothing(j_common_ptr, int) {}
/// A small file may ask for its pixels to be gone through without end.
void count_scans(j_common_ptr image) {
  if (reinterpret_cast<j_decompress_ptr>(image)->input_scan_number > kMaxScans)
    std::longjmp(reinterpret_cast<Trouble*>(image->err)->way_out, kEndless);
}

enum class Outcome { kRead, kCorrupt, kTooLarge, kUnsupported };

/// Ends libjpeg's work whatever comes of it.
struct EndOfWork {
  jpeg_decompress_struct& image;
  ~EndOfWork() { jpeg_destroy_decompress(&image); }
};

/// Holds nothing that would have to be destroyed: errors jump over it.
Outcome decode(std::span<const std::uint8_t> bytes, jpeg_decompress_struct& image, Trouble& trouble, Picture& picture) {
  switch (setjmp(trouble.way_out)) {
    case kBroken:
      return Outcome::kCorrupt;
    case kEndless:
      return Outcome::kTooLarge;
    default:
      break;
  }
  jpeg_create_decompress(&image);
  jpeg_mem_src(&image, bytes.data(), static_cast<unsigned long>(bytes.size()));
  jpeg_read_header(&image, TRUE);
  if (image.image_width > kMaxSide || image.image_height > kMaxSide ||
      std::size_t{image.image_width} * image.image_height > kMaxPixels)
    return Outcome::kTooLarge;
  if (image.jpeg_color_space == JCS_CMYK || image.jpeg_color_space == JCS_YCCK) return Outcome::kUnsupported;
  image.out_color_space = JCS_RGB;
  image.progress = &trouble.progress;
  jpeg_start_decompress(&image);
  picture.width = static_cast<int>(image.output_width);
  picture.height = static_cast<int>(image.output_height);
  picture.rgb.resize(std::size_t{3} * image.output_width * image.output_height);
  while (image.output_scanline < image.output_height) {
    JSAMPROW row = picture.rgb.data() + std::size_t{3} * image.output_width * image.output_scanline;
    jpeg_read_scanlines(&image, &row, 1);
  }
  jpeg_finish_decompress(&image);
  return Outcome::kRead;
}

}  // namespace

Result<Picture> read_jpeg_bytes(std::span<const std::uint8_t> bytes, const std::string& name) {
  jpeg_decompress_struct image{};
  Trouble trouble{};
  image.err = jpeg_std_error(&trouble.manager);
  trouble.manager.error_exit = leave;
  trouble.manager.emit_message = say_nothing;
  trouble.progress.progress_monitor = count_scans;
  Picture picture;
  const EndOfWork end{image};
  switch (decode(bytes, image, trouble, picture)) {
    case Outcome::kRead:
      return picture;
    case Outcome::kTooLarge:
      return fail(ErrorCode::kTooLarge, name + ": over 16,384 pixels on a side, 134 million, or 200 scans");
    case Outcome::kUnsupported:
      return fail(ErrorCode::kUnsupported, name + ": a JPEG in colours of print (CMYK); save it in RGB");
    case Outcome::kCorrupt:
      break;
  }
  return fail(ErrorCode::kCorrupt, name + ": " + trouble.words.data());
}

}  // namespace eigencast
