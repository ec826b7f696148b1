// SPDX-License-Identifier: MIT
#include "common/surface/formats/obj_materials.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <set>

#include "common/core/text.h"
#include "common/surface/appearance.h"
#include "common/surface/formats/file_text.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxFiles = 64;
constexpr std::size_t kMaxImageBytes = std::size_t{16} << 20;
constexpr std::size_t kMaxTextBytes = std::size_t{16} << 20;

struct Material {
  std::array<float, 3> colour{1, 1, 1};
  std::string image;
};

/// Nothing where it is not there, elsewhere or large.
std::optional<std::string> bytes_below(const std::string& folder, const std::string& name, std::size_t most) {
  const std::string path = (fs::path(folder) / name).string();
  std::error_code code;
  if (!text::is_file_below(folder, path) || fs::file_size(path, code) > most || code) return std::nullopt;
  auto bytes = text::bytes_of_file(path);
  if (!bytes) return std::nullopt;
  return std::move(*bytes);
}

/// The file that a map names, behind its options, which are those that start with '-'.
std::string image_in(std::string_view rest) {
  rest = trimmed(rest);
  if (rest.substr(0, 1) == "-") rest = trimmed(rest.substr(rest.find_last_of(" \t") + 1));
  std::string name(rest);
  std::replace(name.begin(), name.end(), '\\', '/');
  return name;
}

void read_library(std::string_view bytes, std::map<std::string, Material, std::less<>>& materials) {
  text::Lines lines(bytes);
  Material* material = nullptr;
  while (const auto line = lines.next()) {
    std::string_view rest = text::without_comment(*line);
    const std::string_view keyword = text::take_token(rest);
    if (keyword == "newmtl") {
      material = &materials[std::string(trimmed(rest))];
    } else if (keyword == "map_Kd" && material != nullptr) {
      material->image = image_in(rest);
    } else if (keyword == "Kd" && material != nullptr) {
      for (float& part : material->colour) {
        const auto value = text::coordinate_from_token(text::take_token(rest));
        if (value) part = linear_from_srgb(static_cast<float>(std::clamp(*value, 0.0, 1.0)));
      }
    }
  }
}

}  // namespace

void add_obj_appearance(const ParsedMesh& mesh, const std::string& folder, Appearance& appearance) {
  appearance.vertex_colour = mesh.colours;
  appearance.corner_uv = mesh.corner_uv;
  if (mesh.material.empty() || mesh.material_files.size() > kMaxFiles) return;
  std::map<std::string, Material, std::less<>> materials;
  for (const std::string& name : mesh.material_files) {
    if (const auto bytes = bytes_below(folder, name, kMaxTextBytes)) read_library(*bytes, materials);
  }
  appearance.face_material = mesh.material;
  std::map<std::string, int> images;
  for (const std::string& name : mesh.material_names) {
    Appearance::Material mine;
    mine.name = name;
    const auto at = materials.find(name);
    if (at != materials.end() && at->second.image.empty())
      std::copy_n(at->second.colour.begin(), 3, mine.base_colour.begin());
    if (at != materials.end() && !at->second.image.empty() && images.size() < kMaxFiles) {
      const auto [image, fresh] = images.try_emplace(at->second.image, static_cast<int>(appearance.images.size()));
      mine.image = image->second;
      if (fresh) {
        const auto bytes = bytes_below(folder, at->second.image, kMaxImageBytes);
        appearance.images.push_back(
            {at->second.image, "",
             bytes ? std::vector<std::uint8_t>(bytes->begin(), bytes->end()) : std::vector<std::uint8_t>()});
      }
    }
    appearance.materials.push_back(std::move(mine));
  }
}

}  // namespace eigencast
