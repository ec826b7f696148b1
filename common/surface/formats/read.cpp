// SPDX-License-Identifier: MIT
#include "common/surface/formats/read.h"

#include <filesystem>
#include <new>
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

struct MeshFormat {
  std::string_view ending;
  Result<ParsedMesh> (*parse)(std::string_view);
};
constexpr MeshFormat kMeshFormats[] = {
    {"obj", parse_obj}, {"off", parse_off}, {"ply", parse_ply}, {"stl", parse_stl}, {"xyz", parse_xyz}};

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
  const std::string ending = text::ending_of(path);
  if (ending == "npy") return surface_from_npy(path);
  if (ending == "pc2" || ending == "mdd") {
    const auto frames = open_point_cache(path);
    return frames ? frames->read(0, nullptr) : frames.error();
  }
  const bool is_gltf = ending == "gltf" || ending == "glb";
  if (is_gltf || is_foreign(ending)) {
    const auto clip = is_gltf ? open_gltf_clip(path, {}) : open_foreign_clip(path, {});
    if (!clip) return clip.error();
    if ((*clip)->appearance() != nullptr) appearance = *(*clip)->appearance();
    return (*clip)->rest();
  }
  for (const MeshFormat& format : kMeshFormats) {
    if (format.ending != ending) continue;
    const auto bytes = text::bytes_of_file(path);
    if (!bytes) return bytes.error();
    auto mesh = format.parse(*bytes);
    if (!mesh) return in_context(path, mesh.error());
    const auto folder = std::filesystem::path(path).parent_path();
    add_obj_appearance(*mesh, folder.empty() ? "." : folder.string(), appearance);
    return std::move(mesh->surface);
  }
  return fail(ErrorCode::kUnsupported, path + ": files that end in " + readable_endings() + " can be read");
}

}  // namespace

std::string readable_endings() {
  const std::string foreign = foreign_endings();
  return "obj, ply, off, stl, xyz, npy, gltf, glb, pc2" +
         (foreign.empty() ? std::string(" or mdd (built without assimp: no fbx, dae)")
                          : ", mdd, " + foreign + " (through assimp)");
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
