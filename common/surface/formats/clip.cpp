// SPDX-License-Identifier: MIT
#include "common/surface/formats/clip.h"

#include <algorithm>
#include <cassert>
#include <filesystem>
#include <new>
#include <optional>
#include <utility>

#include "common/surface/formats/endings.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/foreign.h"
#include "common/surface/formats/frames.h"
#include "common/surface/formats/gltf.h"
#include "common/surface/formats/npy.h"
#include "common/surface/formats/point_cache.h"
#include "common/surface/formats/read.h"
#include "common/surface/formats/sequence.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

class FileFrames final : public Frames {
 public:
  explicit FileFrames(std::vector<std::string> paths) : paths_(std::move(paths)) {}
  std::size_t count() const override { return paths_.size(); }
  Result<Surface> read(std::size_t frame, Appearance* appearance) const override {
    return read_surface(paths_[frame], appearance);
  }
  std::string label(std::size_t frame) const override {
    return "frame " + std::to_string(frame) + " (" + paths_[frame] + ")";
  }

 private:
  std::vector<std::string> paths_;
};

class NpyFrames final : public Frames {
 public:
  NpyFrames(NpyFile file, std::string path) : file_(std::move(file)), path_(std::move(path)) {}
  std::size_t count() const override { return file_.shape()[0]; }
  Result<Surface> read(std::size_t frame, Appearance* /*appearance*/) const override {
    auto positions = file_.read_positions(frame);
    if (!positions) return positions.error();
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
  RecordedClip(std::unique_ptr<Frames> frames, Surface rest, Appearance appearance, bool frames_have_faces,
               std::string name, std::vector<std::string> notes)
      : frames_(std::move(frames)),
        rest_(std::move(rest)),
        appearance_(std::move(appearance)),
        frames_have_faces_(frames_have_faces),
        name_(std::move(name)),
        notes_(std::move(notes)) {}

  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return frames_->count(); }
  double frame_rate_hz() const override { return frames_->rate_hz(); }
  std::string name() const override { return name_; }
  std::vector<std::string> notes() const override { return notes_; }
  const Appearance* appearance() const override { return &appearance_; }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    assert(frame < frame_count());
    auto surface = frames_->read(frame, nullptr);
    if (!surface) return surface.error();
    if (const auto how = difference(*surface, rest_, frames_have_faces_)) {
      return fail(ErrorCode::kInvalidArgument, frames_->label(frame) + " " + *how);
    }
    return std::move(surface->positions);
  }

 private:
  std::unique_ptr<Frames> frames_;
  Surface rest_;
  Appearance appearance_;
  bool frames_have_faces_;
  std::string name_;
  std::vector<std::string> notes_;
};

Result<std::unique_ptr<Frames>> frames_of(std::vector<std::string> paths) {
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
      return std::unique_ptr<Frames>(std::make_unique<NpyFrames>(std::move(*file), paths[0]));
    }
  }
  return std::unique_ptr<Frames>(std::make_unique<FileFrames>(std::move(paths)));
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

// What the options name, or what lies beside the first file where they name nothing.
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
  if (is_one && (ending == "gltf" || ending == "glb")) return open_gltf_clip(first_path, given);
  if (is_one && is_foreign(ending)) return open_foreign_clip(first_path, given);
  const ClipOptions options = is_one ? with_files_beside(given, first_path) : given;
  auto frames = frames_of(std::move(*paths));
  if (!frames) return frames.error();

  Appearance appearance;
  auto first = (*frames)->read(0, &appearance);
  if (!first) return first.error();
  const bool frames_have_faces = !first->is_point_cloud();
  auto rest = rest_of(**frames, std::move(*first), options, appearance);
  if (!rest) return rest.error();
  if (const auto valid = validate_surface(*rest); !valid) return in_context(path, valid.error());
  std::vector<std::string> notes;
  if ((ending == "pc2" || ending == "mdd") && options.rest.empty()) {
    notes.push_back("no rest mesh beside " + first_path + ": played as a point cloud; name one with --rest");
  }
  return std::unique_ptr<MotionClip>(std::make_unique<RecordedClip>(
      std::move(*frames), std::move(*rest), std::move(appearance), frames_have_faces, path, std::move(notes)));
}

}  // namespace

Result<std::unique_ptr<MotionClip>> open_clip(const std::string& path, const ClipOptions& options) {
  try {
    return clip_from_path(path, options);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, path + ": not enough memory to open it");
  }
}

}  // namespace eigencast
