// SPDX-License-Identifier: MIT
#include "common/surface/formats/point_cache.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "common/surface/formats/binary_file.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/motion_clip.h"

namespace eigencast {
namespace {

using std::string_view_literals::operator""sv;

constexpr std::string_view kPc2Magic = "POINTCACHE2\0"sv;
constexpr std::size_t kPc2HeaderBytes = 32;
constexpr std::size_t kMddHeaderBytes = 8;
constexpr std::uint64_t kBytesPerPoint = 12;

struct Layout {
  std::uint64_t points = 0;
  std::uint64_t frames = 0;
  std::uint64_t data_offset = 0;
  double rate_hz = kUnstatedRateHz;
};

template <bool big_endian>
Result<Surface> read_frame(const BinaryFile& file, const Layout& layout, std::size_t frame) {
  std::string bytes(static_cast<std::size_t>(layout.points * kBytesPerPoint), '\0');
  const auto read = file.read_at(layout.data_offset + frame * layout.points * kBytesPerPoint, bytes);
  if (!read) return in_context("frame " + std::to_string(frame), read.error());
  Surface surface;
  surface.positions.resize(static_cast<std::size_t>(layout.points));
  const char* at = bytes.data();
  for (std::size_t i = 0; i < surface.positions.size(); ++i) {
    for (double& coordinate : surface.positions[i]) {
      coordinate = scalar_at<float, big_endian>(at);
      if (!std::isfinite(coordinate)) {
        return fail(ErrorCode::kCorrupt,
                    frame_of_file(frame, file.path()) + ": vertex " + std::to_string(i) + " is not finite");
      }
      at += sizeof(float);
    }
  }
  return surface;
}

Result<void> check_counts(std::int64_t points, std::int64_t frames) {
  if (points < 1 || frames < 1) {
    return fail(ErrorCode::kCorrupt,
                "its header states " + std::to_string(frames) + " frames of " + std::to_string(points) + " vertices");
  }
  if (points > static_cast<std::int64_t>(kMaxSurfaceVertices) || frames > static_cast<std::int64_t>(kMaxClipFrames)) {
    return fail(ErrorCode::kTooLarge, std::to_string(frames) + " frames of " + std::to_string(points) +
                                          " vertices; at most " + std::to_string(kMaxClipFrames) + " of " +
                                          std::to_string(kMaxSurfaceVertices) + " can be read");
  }
  return {};
}

Result<void> check_size(const Layout& layout, std::uint64_t file_bytes) {
  const std::uint64_t frame_bytes = layout.points * kBytesPerPoint;
  const std::uint64_t expected = layout.data_offset + layout.frames * frame_bytes;
  if (file_bytes == expected) return {};
  std::string what =
      "the file has " + std::to_string(file_bytes) + " bytes, its header makes it " + std::to_string(expected);
  if (file_bytes > layout.data_offset && file_bytes < expected) {
    what += ": it ends in frame " + std::to_string((file_bytes - layout.data_offset) / frame_bytes) + " of " +
            std::to_string(layout.frames);
  }
  return fail(ErrorCode::kCorrupt, what);
}

Result<Layout> layout_of_pc2(const BinaryFile& file) {
  std::string header(static_cast<std::size_t>(std::min<std::uint64_t>(kPc2HeaderBytes, file.bytes())), '\0');
  if (const auto read = file.read_at(0, header); !read) return read.error();
  if (header.size() < kPc2HeaderBytes || header.compare(0, kPc2Magic.size(), kPc2Magic) != 0) {
    return fail(ErrorCode::kCorrupt, "not a PC2 cache");
  }
  if (scalar_at<std::int32_t>(&header[12]) != 1) return fail(ErrorCode::kUnsupported, "PC2 of an unknown version");
  const std::int32_t points = scalar_at<std::int32_t>(&header[16]);
  const std::int32_t frames = scalar_at<std::int32_t>(&header[28]);
  if (const auto sound = check_counts(points, frames); !sound) return sound.error();
  Layout layout{static_cast<std::uint64_t>(points), static_cast<std::uint64_t>(frames), kPc2HeaderBytes};
  // Frames between two samples, of a scene whose rate the file does not state.
  const float distance = scalar_at<float>(&header[24]);
  if (std::isfinite(distance) && distance > 0.01F && distance < 100) layout.rate_hz = kUnstatedRateHz / distance;
  return layout;
}

Result<Layout> layout_of_mdd(const BinaryFile& file) {
  if (file.bytes() < kMddHeaderBytes) return fail(ErrorCode::kCorrupt, "not an MDD cache");
  std::string header(kMddHeaderBytes, '\0');
  if (const auto read = file.read_at(0, header); !read) return read.error();
  const std::int32_t frames = scalar_at<std::int32_t, true>(&header[0]);
  const std::int32_t points = scalar_at<std::int32_t, true>(&header[4]);
  if (const auto sound = check_counts(points, frames); !sound) return sound.error();
  Layout layout{static_cast<std::uint64_t>(points), static_cast<std::uint64_t>(frames), 0};
  layout.data_offset = kMddHeaderBytes + layout.frames * sizeof(float);
  if (file.bytes() < layout.data_offset) return fail(ErrorCode::kCorrupt, "the file ends in its table of times");
  std::string first(sizeof(float), '\0');
  std::string last(sizeof(float), '\0');
  if (const auto read = file.read_at(kMddHeaderBytes, first); !read) return read.error();
  if (const auto read = file.read_at(layout.data_offset - sizeof(float), last); !read) return read.error();
  const double seconds = static_cast<double>(scalar_at<float, true>(last.data())) -
                         static_cast<double>(scalar_at<float, true>(first.data()));
  const double rate_hz = static_cast<double>(frames - 1) / seconds;
  // Some programs write no times at all.
  if (seconds > 0 && rate_hz >= 0.1 && rate_hz <= 1000) layout.rate_hz = rate_hz;
  return layout;
}

}  // namespace

Result<Frames> open_point_cache(const std::string& path) {
  const auto file = BinaryFile::open(path);
  if (!file) return file.error();
  const bool is_mdd = text::ending_of(path) == "mdd";
  const auto layout = is_mdd ? layout_of_mdd(**file) : layout_of_pc2(**file);
  if (!layout) return in_context(path, layout.error());
  if (const auto sound = check_size(*layout, (*file)->bytes()); !sound) return in_context(path, sound.error());
  const auto read = is_mdd ? read_frame<true> : read_frame<false>;
  return Frames{
      static_cast<std::size_t>(layout->frames),
      [read, file = *file, layout = *layout](std::size_t frame, Appearance*) { return read(*file, layout, frame); },
      [path](std::size_t frame) { return frame_of_file(frame, path); }, layout->rate_hz};
}

}  // namespace eigencast
