// SPDX-License-Identifier: MIT
#include "common/surface/formats/clip.h"

#include <glob.h>

#include <algorithm>
#include <cassert>
#include <filesystem>
#include <new>
#include <optional>
#include <system_error>
#include <utility>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/foreign.h"
#include "common/surface/formats/gltf.h"
#include "common/surface/formats/npy.h"
#include "common/surface/formats/point_cache.h"
#include "common/surface/formats/read.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

/// Whether the file is a clip by itself, and no frame of another.
bool is_scene(const std::string& path) {
  const auto kind = kind_of_file(path);
  return kind == FileKind::kGltf || kind == FileKind::kForeign;
}

// Lists frames in natural order; `faces.npy` is not one. One that is a clip by itself, where there is nothing else.
Result<std::vector<std::string>> as_sequence(std::vector<std::string> paths, const std::string& where) {
  std::erase_if(paths, [](const std::string& path) { return !text::is_file(path); });
  const auto frames_end = std::stable_partition(paths.begin(), paths.end(), [](const std::string& path) {
    return kind_of_file(path) && !is_scene(path) && fs::path(path).filename() != "faces.npy";
  });
  std::vector<std::string> others(frames_end, paths.end());
  paths.erase(frames_end, paths.end());
  std::erase_if(others, [](const std::string& path) { return !is_scene(path); });
  if (paths.empty() && others.size() == 1) return others;
  if (paths.empty() && others.size() > 1) {
    return fail(ErrorCode::kInvalidArgument, where + ": " + std::to_string(others.size()) +
                                                 " files that are clips by themselves; name one, such as " +
                                                 *std::min_element(others.begin(), others.end(), natural_less));
  }
  if (paths.empty()) {
    return fail(ErrorCode::kNotFound, where + ": no files that end in " + readable_endings());
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
    if (paths.size() > kMaxClipFrames) {
      return fail(ErrorCode::kTooLarge, path + ": more than " + std::to_string(kMaxClipFrames) + " files");
    }
  }
  if (code) return fail(ErrorCode::kIo, path + ": " + code.message());
  return as_sequence(std::move(paths), path);
}

Result<std::vector<std::string>> files_of_glob(const std::string& pattern) {
  glob_t found{};
  const int rc = ::glob(pattern.c_str(), GLOB_NOSORT, nullptr, &found);
  std::vector<std::string> paths;
  if (rc == 0 && found.gl_pathc <= kMaxClipFrames) paths.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  const std::size_t count = found.gl_pathc;
  ::globfree(&found);
  if (rc != 0 && rc != GLOB_NOMATCH) return fail(ErrorCode::kIo, pattern + ": cannot be searched");
  if (count > kMaxClipFrames) {
    return fail(ErrorCode::kTooLarge, pattern + ": more than " + std::to_string(kMaxClipFrames) + " files");
  }
  return as_sequence(std::move(paths), pattern);
}

// Lists a folder or a glob, which must be of one kind, or the path itself. A folder with a `vertices.npy` is that file.
Result<std::vector<std::string>> files_of_sequence(const std::string& path) {
  std::error_code code;
  const auto status = fs::status(path, code);
  if (fs::is_directory(status)) {
    const std::string recording = (fs::path(path) / "vertices.npy").string();
    if (text::is_file(recording)) return std::vector<std::string>{recording};
    return files_in_directory(path);
  }
  if (fs::exists(status) && !fs::is_regular_file(status)) return fail(ErrorCode::kIo, path + ": not a regular file");
  if (!fs::exists(status) && path.find_first_of("*?[") != std::string::npos) return files_of_glob(path);
  return std::vector<std::string>{path};
}

Frames frames_of_files(std::vector<std::string> paths) {
  const auto all = std::make_shared<const std::vector<std::string>>(std::move(paths));
  return {all->size(),
          [all](std::size_t frame, Appearance* appearance) { return read_surface((*all)[frame], appearance); },
          [all](std::size_t frame) { return "frame " + std::to_string(frame) + " (" + (*all)[frame] + ")"; }};
}

Frames frames_of_array(NpyFile file, const std::string& path) {
  const std::size_t count = file.shape()[0];
  return {count,
          [file = std::move(file)](std::size_t frame, Appearance*) -> Result<Surface> {
            auto positions = file.read_positions(frame);
            if (!positions) return positions.error();
            return Surface{std::move(*positions), {}};
          },
          [path](std::size_t frame) { return frame_of_file(frame, path); }};
}

std::string text_from_face(const Face& f) {
  return "(" + std::to_string(f[0]) + ", " + std::to_string(f[1]) + ", " + std::to_string(f[2]) + ")";
}

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

struct Recording {
  Frames frames;
  bool frames_have_faces;
  Surface rest;
  Appearance appearance;
  std::string name;
  std::vector<std::string> notes;
};

class RecordedClip final : public MotionClip {
 public:
  explicit RecordedClip(Recording recording) : r_(std::move(recording)) {}

  const Surface& rest() const override { return r_.rest; }
  std::size_t frame_count() const override { return r_.frames.count; }
  double frame_rate_hz() const override { return r_.frames.rate_hz; }
  std::string name() const override { return r_.name; }
  std::vector<std::string> notes() const override { return r_.notes; }
  const Appearance* appearance() const override { return &r_.appearance; }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    assert(frame < frame_count());
    auto surface = r_.frames.read(frame, nullptr);
    if (!surface) return surface.error();
    if (const auto how = difference(*surface, r_.rest, r_.frames_have_faces)) {
      return fail(ErrorCode::kInvalidArgument, r_.frames.label(frame) + " " + *how);
    }
    return std::move(surface->positions);
  }

 private:
  const Recording r_;
};

Result<Frames> frames_of(std::vector<std::string> paths) {
  const std::string ending = text::ending_of(paths[0]);
  if (paths.size() == 1 && (ending == "pc2" || ending == "mdd")) return open_point_cache(paths[0]);
  if (paths.size() == 1 && ending == "npy") {
    auto file = NpyFile::open(paths[0]);
    if (!file) return file.error();
    if (file->shape().size() == 3) {
      const std::vector<std::size_t>& shape = file->shape();
      if (shape[2] != 3)
        return fail(ErrorCode::kUnsupported, paths[0] + ": positions are an (n, 3) or (T, n, 3) array");
      if (shape[0] == 0) return fail(ErrorCode::kCorrupt, paths[0] + ": no frames in it");
      if (shape[0] > kMaxClipFrames) return fail(ErrorCode::kTooLarge, paths[0] + ": too many frames");
      if (shape[1] > kMaxSurfaceVertices) return fail(ErrorCode::kTooLarge, paths[0] + ": too many vertices");
      return frames_of_array(std::move(*file), paths[0]);
    }
  }
  return frames_of_files(std::move(paths));
}

Result<std::vector<Face>> faces_from_file(const std::string& path) {
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
  auto faces = faces_from_file(path);
  if (!faces) return faces.error();
  if (rest.is_point_cloud()) {
    rest.faces = std::move(*faces);
  } else if (const auto how = difference({rest.positions, std::move(*faces)}, rest, true)) {
    return fail(ErrorCode::kInvalidArgument, path + " " + *how);
  }
  return {};
}

// The mesh that a cache's vertices belong to: of the same name, or called "rest" where `any_rest`.
std::string rest_beside(const std::string& cache, bool any_rest) {
  const fs::path path(cache);
  for (const std::string& stem : {path.stem().string(), std::string("rest")}) {
    if (!any_rest && stem != path.stem().string()) continue;
    for (const char* ending : {".obj", ".ply", ".off", ".glb", ".gltf", ".stl"}) {
      const std::string beside = (path.parent_path() / (stem + ending)).string();
      if (text::is_file(beside)) return beside;
    }
  }
  return {};
}

ClipOptions with_files_beside(ClipOptions options, const std::string& first) {
  const std::string ending = text::ending_of(first);
  const bool is_cache = ending == "pc2" || ending == "mdd" || ending == "npy";
  if (options.rest.empty() && is_cache) options.rest = rest_beside(first, ending != "npy");
  const std::string faces = (fs::path(first).parent_path() / "faces.npy").string();
  if (options.faces.empty() && ending == "npy" && text::is_file(faces)) options.faces = faces;
  return options;
}

Result<Surface> rest_of(const Frames& frames, Surface first, const ClipOptions& options, Appearance& appearance) {
  Surface rest = std::move(first);
  if (!options.rest.empty()) {
    auto stated = read_surface(options.rest, &appearance);
    if (!stated) return stated.error();
    if (const auto how = difference(rest, *stated, !rest.is_point_cloud() && !stated->is_point_cloud())) {
      return fail(ErrorCode::kInvalidArgument, frames.label(0) + " " + *how + " (" + options.rest + ")");
    }
    if (stated->is_point_cloud()) stated->faces = std::move(rest.faces);
    rest = std::move(*stated);
  }
  if (!options.faces.empty()) {
    if (const auto added = add_faces(rest, options.faces); !added) return added.error();
  }
  return rest;
}

Result<std::unique_ptr<MotionClip>> clip_from_path(const std::string& path, const ClipOptions& given) {
  auto paths = files_of_sequence(path);
  if (!paths) return paths.error();
  const std::string first_path = paths->front();
  const bool is_one = paths->size() == 1;
  const std::string ending = text::ending_of(first_path);
  if (is_one && is_scene(first_path)) {
    return kind_of_file(first_path) == FileKind::kGltf ? open_gltf_clip(first_path, given)
                                                       : open_foreign_clip(first_path, given);
  }
  const ClipOptions options = is_one ? with_files_beside(given, first_path) : given;
  auto frames = frames_of(std::move(*paths));
  if (!frames) return frames.error();

  Appearance appearance;
  auto first = frames->read(0, &appearance);
  if (!first) return first.error();
  const bool frames_have_faces = !first->is_point_cloud();
  auto rest = rest_of(*frames, std::move(*first), options, appearance);
  if (!rest) return rest.error();
  if (const auto valid = validate_surface(*rest); !valid) return in_context(path, valid.error());
  std::vector<std::string> notes;
  if ((ending == "pc2" || ending == "mdd") && options.rest.empty()) {
    notes.push_back("no rest mesh beside " + first_path + ": played as a point cloud; name one with --rest");
  }
  return std::unique_ptr<MotionClip>(std::make_unique<RecordedClip>(Recording{
      std::move(*frames), frames_have_faces, std::move(*rest), std::move(appearance), path, std::move(notes)}));
}

}  // namespace

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

Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const ClipOptions& options) {
  try {
    return clip_from_path(path, options);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, path + ": not enough memory to open it");
  }
}

}  // namespace eigencast
