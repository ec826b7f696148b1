// SPDX-License-Identifier: MIT
#include "common/surface/formats/write.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <filesystem>
#include <system_error>

#include "common/core/files.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/new_file.h"
#include "common/surface/formats/usd.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

enum class Form : std::uint8_t {
  kFolder,    ///< A file for each pose, in it.
  kSequence,  ///< A file for each pose, beside each other.
  kCache,     ///< One file, with the rest pose beside it.
  kUsd,       ///< One file.
  kMorphed,   ///< Likewise; by write_morphed().
};

Result<std::string> ending_of_surface(const std::string& path) {
  std::string ending = text::ending_of(path);
  if (ending == "obj" || ending == "ply" || ending == "off") return ending;
  return fail(ErrorCode::kUnsupported, path + ": files that end in obj, ply or off can be written");
}

Result<Form> form_of(const std::string& path, const std::string& ending) {
  std::error_code ignored;
  if (path.empty() || path.back() == '/' || fs::is_directory(path, ignored)) return Form::kFolder;
  if (ending == "pc2" || ending == "mdd" || ending == "npy") return Form::kCache;
  if (ending == "obj" || ending == "ply" || ending == "off") return Form::kSequence;
  if (ending == "usda") return Form::kUsd;
  if (ending == "glb") return Form::kMorphed;
  return fail(ErrorCode::kUnsupported,
              path +
                  ": clips that end in glb, usda, pc2, mdd, npy, obj, ply or off, and folders (ending in /) can be "
                  "written");
}

void append_position(std::string& text, const char* start, const Vec3& p) {
  text += start;
  for (std::size_t c = 0; c < 3; ++c) {
    if (c > 0) text += ' ';
    append_number(text, p[c]);
  }
  text += '\n';
}

void append_face(std::string& text, const char* start, const Face& f, std::uint32_t first_index) {
  text += start;
  for (std::size_t c = 0; c < 3; ++c) text += ' ' + std::to_string(f[c] + first_index);
  text += '\n';
}

std::string obj_text(const Surface& surface) {
  std::string text;
  for (const Vec3& p : surface.positions) append_position(text, "v ", p);
  for (const Face& f : surface.faces) append_face(text, "f", f, 1);
  return text;
}

std::string off_text(const Surface& surface) {
  std::string text =
      "OFF\n" + std::to_string(surface.positions.size()) + " " + std::to_string(surface.faces.size()) + " 0\n";
  for (const Vec3& p : surface.positions) append_position(text, "", p);
  for (const Face& f : surface.faces) append_face(text, "3", f, 0);
  return text;
}

template <typename T>
void append_bytes(std::string& bytes, T value, bool big_endian = false) {
  auto copy = std::bit_cast<std::array<char, sizeof(T)>>(value);
  if (big_endian) std::reverse(copy.begin(), copy.end());
  bytes.append(copy.data(), copy.size());
}

std::string ply_bytes(const Surface& surface) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\nelement vertex " +
                      std::to_string(surface.positions.size()) +
                      "\nproperty double x\nproperty double y\nproperty double z\n";
  if (!surface.faces.empty()) {
    bytes += "element face " + std::to_string(surface.faces.size()) + "\nproperty list uchar int vertex_indices\n";
  }
  bytes += "end_header\n";
  for (const Vec3& p : surface.positions) {
    for (const double x : p) append_bytes(bytes, x);
  }
  for (const Face& f : surface.faces) {
    bytes += '\3';
    for (const std::uint32_t corner : f) append_bytes(bytes, corner);
  }
  return bytes;
}

std::string npy_header(std::size_t vertices, std::size_t frames) {
  std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (" + std::to_string(frames) + ", " +
                       std::to_string(vertices) + ", 3), }";
  header.append(63 - (10 + header.size()) % 64, ' ') += '\n';
  std::string bytes("\x93NUMPY\x01\x00", 8);
  append_bytes(bytes, static_cast<std::uint16_t>(header.size()));
  return bytes + header;
}

std::string pc2_header(std::size_t vertices, std::size_t frames) {
  std::string bytes("POINTCACHE2\0", 12);
  append_bytes(bytes, std::uint32_t{1});
  append_bytes(bytes, static_cast<std::uint32_t>(vertices));
  append_bytes(bytes, 0.0F);
  append_bytes(bytes, 1.0F);
  append_bytes(bytes, static_cast<std::uint32_t>(frames));
  return bytes;
}

std::string mdd_header(std::size_t vertices, std::size_t frames, double rate_hz) {
  std::string bytes;
  append_bytes(bytes, static_cast<std::uint32_t>(frames), true);
  append_bytes(bytes, static_cast<std::uint32_t>(vertices), true);
  for (std::size_t frame = 0; frame < frames; ++frame)
    append_bytes(bytes, static_cast<float>(static_cast<double>(frame) / rate_hz), true);
  return bytes;
}

std::string bytes_of_pose(const std::vector<Vec3>& pose, bool big_endian) {
  std::string bytes;
  bytes.reserve(pose.size() * 12);
  for (const Vec3& p : pose) {
    for (const double x : p) append_bytes(bytes, static_cast<float>(x), big_endian);
  }
  return bytes;
}

template <typename Write>
Result<void> for_each_pose(const MotionClip& clip, const WriteProgress& progress, const Write& write) {
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    if (progress && !progress(static_cast<double>(frame) / static_cast<double>(clip.frame_count()))) {
      return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
    }
    auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    if (const auto written = write(frame, std::move(*pose)); !written) return written;
  }
  return {};
}

Result<void> write_cache(const MotionClip& clip, const std::string& path, const std::string& ending,
                         const WriteProgress& progress) {
  const std::size_t n = clip.rest().vertex_count();
  const std::size_t frames = clip.frame_count();
  NewFile file(path);
  const auto begun = file.write(ending == "pc2"   ? pc2_header(n, frames)
                                : ending == "mdd" ? mdd_header(n, frames, clip.frame_rate_hz())
                                                  : npy_header(n, frames));
  if (!begun) return begun;
  const auto written = for_each_pose(clip, progress, [&](std::size_t, const std::vector<Vec3>& pose) {
    return file.write(bytes_of_pose(pose, ending == "mdd"));
  });
  if (!written) return written;
  if (const auto rest = write_surface(clip.rest(), fs::path(path).replace_extension(".obj").string()); !rest)
    return rest;
  return file.finish();
}

Result<void> write_sequence(const MotionClip& clip, const fs::path& start, const std::string& ending,
                            const WriteProgress& progress) {
  std::error_code code;
  if (start.has_parent_path()) fs::create_directories(start.parent_path(), code);
  if (code) return fail(ErrorCode::kIo, start.parent_path().string() + ": cannot be made: " + code.message());
  return for_each_pose(clip, progress, [&](std::size_t frame, std::vector<Vec3> pose) {
    char number[32];
    std::snprintf(number, sizeof number, "_%06zu.", frame);
    return write_surface({std::move(pose), clip.rest().faces}, start.string() + number + ending);
  });
}

}  // namespace

Result<void> check_surface_path(const std::string& path) {
  const auto ending = ending_of_surface(path);
  return ending ? check_output_file(path) : ending.error();
}

Result<void> check_clip_path(const std::string& path) {
  const auto form = form_of(path, text::ending_of(path));
  if (!form) return form.error();
  if (*form == Form::kFolder || *form == Form::kSequence)
    return check_output_folder(*form == Form::kFolder ? path : fs::path(path).parent_path().string());
  return check_output_file(path);
}

Result<void> write_surface(const Surface& surface, const std::string& path) {
  const auto ending = ending_of_surface(path);
  if (!ending) return ending.error();
  return write_file_atomically(path, *ending == "obj"   ? obj_text(surface)
                                     : *ending == "ply" ? ply_bytes(surface)
                                                        : off_text(surface));
}

Result<void> write_clip(const MotionClip& clip, const std::string& path, const WriteProgress& progress) {
  const std::string ending = text::ending_of(path);
  const auto form = form_of(path, ending);
  if (!form) return form.error();
  if (*form == Form::kCache) return write_cache(clip, path, ending, progress);
  if (*form == Form::kUsd) return write_usd(clip, path, progress);
  if (*form == Form::kMorphed)
    return fail(ErrorCode::kUnsupported, path + ": glTF holds a MorphedMotion, see write_morphed()");
  return *form == Form::kFolder ? write_sequence(clip, fs::path(path) / "frame", "obj", progress)
                                : write_sequence(clip, fs::path(path).replace_extension(), ending, progress);
}

}  // namespace eigencast
