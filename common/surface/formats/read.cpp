// SPDX-License-Identifier: MIT
#include "common/surface/formats/read.h"

#include <algorithm>
#include <iterator>
#include <new>
#include <span>
#include <string_view>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/foreign.h"
#include "common/surface/formats/gltf.h"
#include "common/surface/formats/npy.h"
#include "common/surface/formats/parsed_mesh.h"
#include "common/surface/formats/point_cache.h"

namespace eigencast {
namespace {

// x y z, then whatever the file holds beside (a normal, an intensity).
Result<ParsedMesh> parse_xyz(std::string_view bytes) {
  Surface surface;
  text::Lines lines(bytes);
  while (const auto line = lines.next()) {
    std::string_view rest = text::without_comment(*line), probe = rest;
    if (text::take_token(probe).empty()) continue;
    const auto p = text::take_position(rest, lines.number(), "a point");
    if (!p) return p.error();
    surface.positions.push_back(*p);
  }
  if (const auto sizes = check_sizes(surface.positions.size(), 0); !sizes) return sizes.error();
  return ParsedMesh{std::move(surface)};
}

struct Format {
  std::string_view ending;
  FileKind kind;
  Result<ParsedMesh> (*parse)(std::string_view) = nullptr;  ///< Of meshes.
};
/// All but those of foreign.h.
constexpr Format kFormats[] = {{"obj", FileKind::kMesh, parse_obj}, {"ply", FileKind::kMesh, parse_ply},
                               {"off", FileKind::kMesh, parse_off}, {"stl", FileKind::kMesh, parse_stl},
                               {"xyz", FileKind::kMesh, parse_xyz}, {"npy", FileKind::kArray},
                               {"gltf", FileKind::kGltf},           {"glb", FileKind::kGltf},
                               {"pc2", FileKind::kPointCache},      {"mdd", FileKind::kPointCache}};

const Format* format_of(std::string_view ending) {
  const auto found = std::find_if(std::begin(kFormats), std::end(kFormats),
                                  [&](const Format& format) { return format.ending == ending; });
  return found == std::end(kFormats) ? nullptr : found;
}

Result<Surface> surface_from_npy(const std::string& path) {
  const auto file = NpyFile::open(path);
  if (!file) return file.error();
  const std::vector<std::size_t>& shape = file->shape();
  if (shape.size() < 2 || shape.back() != 3) {
    return fail(ErrorCode::kUnsupported, path + ": positions are an (n, 3) or (T, n, 3) array");
  }
  const std::size_t n = shape[shape.size() - 2];
  if (const auto sizes = check_sizes(n, 0); !sizes) return in_context(path, sizes.error());
  if (shape[0] == 0) return fail(ErrorCode::kCorrupt, path + ": no frames in it");
  auto positions = file->read_positions(0);
  if (!positions) return positions.error();
  return Surface{std::move(*positions), {}};
}

Result<Surface> surface_from_file(const std::string& path, Appearance& appearance) {
  const auto kind = kind_of_file(path);
  if (!kind) return fail(ErrorCode::kUnsupported, path + ": files that end in " + readable_endings() + " can be read");
  if (kind == FileKind::kArray) return surface_from_npy(path);
  if (kind == FileKind::kPointCache) {
    const auto frames = open_point_cache(path);
    return frames ? frames->read(0, nullptr) : frames.error();
  }
  if (kind != FileKind::kMesh) {
    const auto clip = kind == FileKind::kGltf ? open_gltf_clip(path, {}) : open_foreign_clip(path, {});
    if (!clip) return clip.error();
    if ((*clip)->appearance() != nullptr) appearance = *(*clip)->appearance();
    return (*clip)->rest();
  }
  const auto bytes = text::bytes_of_file(path);
  if (!bytes) return bytes.error();
  auto mesh = format_of(text::ending_of(path))->parse(*bytes);
  if (!mesh) return in_context(path, mesh.error());
  add_obj_appearance(*mesh, path, appearance);
  return std::move(mesh->surface);
}

}  // namespace

std::optional<FileKind> kind_of_file(const std::string& path) {
  const std::string ending = text::ending_of(path);
  if (const Format* format = format_of(ending)) return format->kind;
  return is_foreign(ending) ? std::optional(FileKind::kForeign) : std::nullopt;
}

std::string readable_endings() {
  const std::string foreign = foreign_endings();
  std::string all(kFormats[0].ending);
  for (const Format& format : std::span(kFormats).subspan(1)) {
    const bool last = foreign.empty() && &format == std::end(kFormats) - 1;
    all.append(last ? " or " : ", ").append(format.ending);
  }
  return all +
         (foreign.empty() ? std::string(" (built without assimp: no fbx, dae)") : ", " + foreign + " (through assimp)");
}

Result<Surface> read_surface(const std::string& path, Appearance* appearance) {
  try {
    Appearance unwanted;
    return surface_from_file(path, appearance != nullptr ? *appearance : unwanted);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, path + ": not enough memory to read it");
  }
}

}  // namespace eigencast
