// SPDX-License-Identifier: MIT
#include "common/surface/formats/read.h"

#include <filesystem>
#include <new>
#include <string_view>

#include "common/surface/formats/endings.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/foreign.h"
#include "common/surface/formats/gltf.h"
#include "common/surface/formats/npy.h"
#include "common/surface/formats/obj_materials.h"
#include "common/surface/formats/parsed_mesh.h"
#include "common/surface/formats/point_cache.h"

namespace eigencast {
namespace {

struct MeshFormat {
  std::string_view ending;
  Result<ParsedMesh> (*parse)(std::string_view);
};
constexpr MeshFormat kMeshFormats[] = {{"obj", parse_obj}, {"off", parse_off}, {"ply", parse_ply}, {"stl", parse_stl}};

// x y z, then whatever the file holds beside (a normal, an intensity).
Result<Surface> surface_from_xyz(std::string_view bytes) {
  Surface surface;
  text::Lines lines(bytes);
  while (const auto line = lines.next()) {
    std::string_view rest = text::without_comment(*line);
    std::string_view token = text::take_token(rest);
    if (token.empty()) continue;
    Vec3 p{};
    for (double& coordinate : p) {
      const auto value = text::coordinate_from_token(token);
      if (!value) {
        return text::corrupt_at(lines.number(), "a point needs three finite numbers, not " + text::quoted(token));
      }
      coordinate = *value;
      token = text::take_token(rest);
    }
    surface.positions.push_back(p);
  }
  if (const auto sizes = check_sizes(surface.positions.size(), 0); !sizes) return sizes.error();
  return surface;
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

Result<Surface> surface_from_cache(const std::string& path) {
  const auto frames = open_point_cache(path);
  if (!frames) return frames.error();
  return (*frames)->read(0, nullptr);
}

Result<Surface> surface_from_file(const std::string& path, Appearance& appearance) {
  const std::string ending = text::ending_of(path);
  if (ending == "npy") return surface_from_npy(path);
  if (ending == "pc2" || ending == "mdd") return surface_from_cache(path);
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
  if (ending == "xyz") {
    const auto bytes = text::bytes_of_file(path);
    if (!bytes) return bytes.error();
    auto surface = surface_from_xyz(*bytes);
    if (!surface) return in_context(path, surface.error());
    return surface;
  }
  return fail(ErrorCode::kUnsupported, path + ": files that end in " + readable_endings() + " can be read");
}

}  // namespace

Result<Surface> read_surface(const std::string& path, Appearance* appearance) {
  try {
    Appearance unwanted;
    return surface_from_file(path, appearance != nullptr ? *appearance : unwanted);
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, path + ": not enough memory to read it");
  }
}

}  // namespace eigencast
