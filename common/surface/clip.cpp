// SPDX-License-Identifier: MIT
#include <glob.h>

#include <algorithm>
#include <cassert>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include "common/surface/check.h"
#include "common/surface/file_text.h"
#include "common/surface/natural_order.h"
#include "common/surface/npy.h"
#include "common/surface/read.h"

namespace eigencast {

namespace fs = std::filesystem;

bool natural_less(std::string_view a, std::string_view b) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[j])) {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
      ++i;
      ++j;
      continue;
    }
    while (i < a.size() && a[i] == '0') ++i;
    while (j < b.size() && b[j] == '0') ++j;
    std::size_t a_end = i;
    std::size_t b_end = j;
    while (a_end < a.size() && is_digit(a[a_end])) ++a_end;
    while (b_end < b.size() && is_digit(b[b_end])) ++b_end;
    if (a_end - i != b_end - j) return a_end - i < b_end - j;
    const int order = a.substr(i, a_end - i).compare(b.substr(j, b_end - j));
    if (order != 0) return order < 0;
    i = a_end;
    j = b_end;
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;
}

namespace {

constexpr double kUnstatedRateHz = 30;
constexpr std::size_t kMaxFrames = 1'000'000;

/// Where poses come from: positions, and faces where the format has any.
class Frames {
 public:
  virtual ~Frames() = default;
  virtual std::size_t count() const = 0;
  virtual Result<Surface> read(std::size_t frame) const = 0;
  virtual std::string label(std::size_t frame) const = 0;
};

class FileFrames final : public Frames {
 public:
  explicit FileFrames(std::vector<std::string> paths) : paths_(std::move(paths)) {}
  std::size_t count() const override { return paths_.size(); }
  Result<Surface> read(std::size_t frame) const override { return read_surface(paths_[frame]); }
  std::string label(std::size_t frame) const override {
    return "frame " + std::to_string(frame) + " (" + paths_[frame] + ")";
  }

 private:
  std::vector<std::string> paths_;
};

// Reads one frame at a time, so that a clip may be larger than memory.
class NpyFrames final : public Frames {
 public:
  NpyFrames(NpyFile file, std::string path) : file_(std::move(file)), path_(std::move(path)) {}
  std::size_t count() const override { return file_.shape()[0]; }
  Result<Surface> read(std::size_t frame) const override {
    const std::size_t n = file_.shape()[1];
    auto positions = file_.read_positions(frame * n, n);
    if (!positions) return in_context("frame " + std::to_string(frame), positions.error());
    return Surface{std::move(*positions), {}};
  }
  std::string label(std::size_t frame) const override { return "frame " + std::to_string(frame) + " of " + path_; }

 private:
  NpyFile file_;
  std::string path_;
};

std::string text_from_face(const Face& f) {
  return "(" + std::to_string(f[0]) + ", " + std::to_string(f[1]) + ", " + std::to_string(f[2]) + ")";
}

// How the topology of `frame` differs from that of the rest pose.
std::optional<std::string> difference(const Surface& frame, const Surface& rest, bool with_faces) {
  if (frame.vertex_count() != rest.vertex_count()) {
    return "has " + std::to_string(frame.vertex_count()) + " vertices, the rest pose " +
           std::to_string(rest.vertex_count());
  }
  if (!with_faces) return std::nullopt;
  if (frame.faces.size() != rest.faces.size()) {
    return "has " + std::to_string(frame.faces.size()) + " triangles, the rest pose " +
           std::to_string(rest.faces.size());
  }
  const auto [mine, theirs] = std::mismatch(frame.faces.begin(), frame.faces.end(), rest.faces.begin());
  if (mine == frame.faces.end()) return std::nullopt;
  return "has triangle " + std::to_string(mine - frame.faces.begin()) + " = " + text_from_face(*mine) +
         ", the rest pose " + text_from_face(*theirs);
}

class RecordedClip final : public MotionClip {
 public:
  RecordedClip(std::unique_ptr<Frames> frames, Surface rest, bool frames_have_faces, std::string name)
      : frames_(std::move(frames)),
        rest_(std::move(rest)),
        frames_have_faces_(frames_have_faces),
        name_(std::move(name)) {}

  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return frames_->count(); }
  double frame_rate_hz() const override { return kUnstatedRateHz; }
  std::string name() const override { return name_; }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    assert(frame < frame_count());
    auto surface = frames_->read(frame);
    if (!surface) return surface.error();
    if (const auto how = difference(*surface, rest_, frames_have_faces_)) {
      return fail(ErrorCode::kInvalidArgument, frames_->label(frame) + " " + *how);
    }
    return std::move(surface->positions);
  }

 private:
  std::unique_ptr<Frames> frames_;
  Surface rest_;
  bool frames_have_faces_;
  std::string name_;
};

bool is_file(const fs::path& path) {
  std::error_code code;
  return fs::is_regular_file(path, code);
}

bool is_readable_kind(const std::string& path) {
  const std::string ending = text::ending_of(path);
  return ending == "obj" || ending == "off" || ending == "ply" || ending == "stl" || ending == "xyz" || ending == "npy";
}

// Files of one kind, in natural order; `faces.npy` is not a frame.
Result<std::vector<std::string>> as_sequence(std::vector<std::string> paths, const std::string& where) {
  std::erase_if(paths, [](const std::string& path) {
    return !is_readable_kind(path) || fs::path(path).filename() == "faces.npy" || !is_file(path);
  });
  if (paths.empty()) {
    return fail(ErrorCode::kNotFound, where + ": no files that end in obj, ply, off, stl, xyz or npy");
  }
  std::sort(paths.begin(), paths.end(), natural_less);
  for (const std::string& path : paths) {
    if (text::ending_of(path) == text::ending_of(paths[0])) continue;
    std::string what = where;
    what.append(": files of more than one kind (").append(paths[0]).append(", ").append(path);
    return fail(ErrorCode::kInvalidArgument, what + "); give a glob such as \"*.obj\" in quotes");
  }
  return paths;
}

Result<std::vector<std::string>> files_in_directory(const std::string& path) {
  std::vector<std::string> paths;
  std::error_code code;
  for (fs::directory_iterator it(path, code), end; !code && it != end; it.increment(code)) {
    if (it->path().filename().string()[0] != '.') paths.push_back(it->path().string());
    if (paths.size() > kMaxFrames) {
      return fail(ErrorCode::kTooLarge, path + ": more than " + std::to_string(kMaxFrames) + " files");
    }
  }
  if (code) return fail(ErrorCode::kIo, path + ": " + code.message());
  return as_sequence(std::move(paths), path);
}

Result<std::vector<std::string>> files_of_glob(const std::string& pattern) {
  glob_t found{};
  const int rc = ::glob(pattern.c_str(), GLOB_NOSORT, nullptr, &found);
  std::vector<std::string> paths;
  if (rc == 0 && found.gl_pathc <= kMaxFrames) paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  const std::size_t count = found.gl_pathc;
  ::globfree(&found);
  if (rc != 0 && rc != GLOB_NOMATCH) return fail(ErrorCode::kIo, pattern + ": cannot be searched");
  if (count > kMaxFrames) {
    return fail(ErrorCode::kTooLarge, pattern + ": more than " + std::to_string(kMaxFrames) + " files");
  }
  return as_sequence(std::move(paths), pattern);
}

Result<std::vector<std::string>> files_of(const std::string& path) {
  std::error_code code;
  const auto status = fs::status(path, code);
  if (fs::is_directory(status)) {
    const fs::path recording = fs::path(path) / "vertices.npy";
    if (is_file(recording)) return std::vector<std::string>{recording.string()};
    return files_in_directory(path);
  }
  if (!fs::exists(status) && path.find_first_of("*?[") != std::string::npos) return files_of_glob(path);
  return std::vector<std::string>{path};
}

Result<std::unique_ptr<Frames>> frames_of(std::vector<std::string> paths) {
  if (paths.size() == 1 && text::ending_of(paths[0]) == "npy") {
    auto file = NpyFile::open(paths[0]);
    if (!file) return file.error();
    if (file->shape().size() == 3) {
      const std::vector<std::size_t>& shape = file->shape();
      if (shape[2] != 3)
        return fail(ErrorCode::kUnsupported, paths[0] + ": positions are an (n, 3) or (T, n, 3) array");
      if (shape[0] == 0) return fail(ErrorCode::kCorrupt, paths[0] + ": no frames in it");
      if (shape[1] > kMaxSurfaceVertices) return fail(ErrorCode::kTooLarge, paths[0] + ": too many vertices");
      return std::unique_ptr<Frames>(std::make_unique<NpyFrames>(std::move(*file), paths[0]));
    }
  }
  return std::unique_ptr<Frames>(std::make_unique<FileFrames>(std::move(paths)));
}

Result<std::vector<Face>> faces_of(const std::string& path) {
  if (text::ending_of(path) != "npy") {
    auto surface = read_surface(path);
    if (!surface) return surface.error();
    return std::move(surface->faces);
  }
  const auto file = NpyFile::open(path);
  if (!file) return file.error();
  return file->read_faces();
}

// Gives `rest` the faces of `path`; where it has its own, they must be the same.
Result<void> add_faces(Surface& rest, const std::string& path) {
  auto faces = faces_of(path);
  if (!faces) return faces.error();
  if (rest.is_point_cloud()) {
    rest.faces = std::move(*faces);
  } else if (const auto how = difference({rest.positions, std::move(*faces)}, rest, true)) {
    return fail(ErrorCode::kInvalidArgument, path + " " + *how);
  }
  return {};
}

Result<std::unique_ptr<MotionClip>> clip_from_path(const std::string& path, const std::string& rest_path,
                                                   const std::string& faces_path) {
  auto paths = files_of(path);
  if (!paths) return paths.error();
  std::string faces_file = faces_path;
  if (faces_file.empty() && text::ending_of((*paths)[0]) == "npy") {
    const fs::path beside = fs::path((*paths)[0]).parent_path() / "faces.npy";
    if (is_file(beside)) faces_file = beside.string();
  }
  auto frames = frames_of(std::move(*paths));
  if (!frames) return frames.error();

  auto first = (*frames)->read(0);
  if (!first) return first.error();
  const bool frames_have_faces = !first->is_point_cloud();
  Surface rest = std::move(*first);
  if (!rest_path.empty()) {
    auto stated = read_surface(rest_path);
    if (!stated) return stated.error();
    if (const auto how = difference(rest, *stated, frames_have_faces && !stated->is_point_cloud())) {
      return fail(ErrorCode::kInvalidArgument, (*frames)->label(0) + " " + *how);
    }
    if (stated->is_point_cloud()) stated->faces = std::move(rest.faces);
    rest = std::move(*stated);
  }
  if (!faces_file.empty()) {
    if (const auto added = add_faces(rest, faces_file); !added) return added.error();
  }
  if (const auto valid = validate_surface(rest); !valid) return in_context(path, valid.error());
  return std::unique_ptr<MotionClip>(
      std::make_unique<RecordedClip>(std::move(*frames), std::move(rest), frames_have_faces, path));
}

}  // namespace

Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const std::string& rest_path,
                                              const std::string& faces_path) {
  try {
    return clip_from_path(path, rest_path, faces_path);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, path + ": not enough memory to open it");
  }
}

}  // namespace eigencast
