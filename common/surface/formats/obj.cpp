// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "common/core/text.h"
#include "common/surface/formats/file_text.h"
#include "common/surface/formats/parsed_mesh.h"
#include "common/surface/vertex_normals.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
using text::corrupt_at;
using text::quoted;

constexpr float kNoUv = std::numeric_limits<float>::quiet_NaN();

class ObjParser {
 public:
  explicit ObjParser(std::string_view bytes) : lines_(bytes) {}

  Result<ParsedMesh> run() {
    std::string joined;
    while (const auto line = lines_.next()) {
      std::string_view rest = text::without_comment(*line);
      // A backslash at the end carries a line on.
      if (!rest.empty() && rest.back() == '\\') {
        joined.append(rest.substr(0, rest.size() - 1)) += ' ';
        continue;
      }
      const std::string whole = joined.empty() ? std::string() : joined.append(rest);
      if (!whole.empty()) rest = whole;
      joined.clear();
      const std::string_view keyword = text::take_token(rest);
      Result<void> taken;
      if (keyword == "v") taken = take_vertex(rest);
      if (keyword == "f") taken = take_face(rest);
      if (keyword == "vt") take_uv(rest);
      if (keyword == "vn") take_normal(rest);
      if (keyword == "usemtl") take_material(rest);
      if (keyword == "mtllib") mesh_.material_files.emplace_back(trimmed(rest));
      if (!taken) return taken.error();
    }
    if (!joined.empty()) return corrupt_at(lines_.number(), "the file ends where a line should go on");
    if (largest_index_ > vertex_count()) {
      return corrupt_at(line_of_largest_, "a face refers to vertex " + std::to_string(largest_index_) +
                                              ", but there are " + std::to_string(vertex_count()));
    }
    resolve_uvs();
    resolve_normals();
    if (!any_material_) mesh_.material.clear();
    return finished(std::move(mesh_));
  }

 private:
  std::int64_t vertex_count() const { return static_cast<std::int64_t>(mesh_.surface.positions.size()); }

  Result<void> take_vertex(std::string_view rest) {
    const auto p = text::take_position(rest, lines_.number(), "a vertex");
    if (!p) return p.error();
    mesh_.surface.positions.push_back(*p);
    take_colour(rest);
    return {};
  }

  // Three numbers more, of 0 to 1, as many programs write them; a single one is a weight, of which nothing is made.
  void take_colour(std::string_view rest) {
    std::array<double, 3> parts{};
    for (double& part : parts) {
      const auto value = text::coordinate_from_token(text::take_token(rest));
      if (!value) return;
      part = *value;
    }
    mesh_.colours.push_back(colour_from_parts(parts));
  }

  // What is not a number becomes NaN, so that the others keep their numbers.
  void take_uv(std::string_view rest) {
    std::array<float, 2> uv{kNoUv, kNoUv};
    const auto u = text::coordinate_from_token(text::take_token(rest));
    const std::string_view second = text::take_token(rest);
    const auto v = second.empty() ? std::optional<double>(0) : text::coordinate_from_token(second);
    // Images begin below here, and above everywhere else.
    if (u && v) uv = {static_cast<float>(*u), static_cast<float>(1 - *v)};
    uvs_.push_back(uv);
  }

  // What is not a direction becomes none, likewise.
  void take_normal(std::string_view rest) {
    std::array<float, 3> normal{};
    for (float& part : normal) {
      const auto value = text::coordinate_from_token(text::take_token(rest));
      part = value ? static_cast<float>(*value) : std::numeric_limits<float>::quiet_NaN();
    }
    normals_.push_back(normal);
  }

  void take_material(std::string_view rest) {
    const std::string name(trimmed(rest));
    const auto [at, fresh] = number_of_material_.try_emplace(name, static_cast<int>(mesh_.material_names.size()));
    if (fresh) mesh_.material_names.push_back(name);
    material_ = at->second;
  }

  // The number, from 1, that is the `part`-th of "7/8/9", counted from 0 and back from `count`; 0: none is stated.
  static std::uint32_t number_in(std::string_view token, std::size_t part, std::size_t count) {
    for (; part > 0; --part) {
      const std::size_t slash = token.find('/');
      if (slash == std::string_view::npos) return 0;
      token.remove_prefix(slash + 1);
    }
    const auto stated = text::integer_from_token(token.substr(0, std::min(token.find('/'), token.size())));
    const std::int64_t index = !stated ? 0 : *stated < 0 ? static_cast<std::int64_t>(count) + 1 + *stated : *stated;
    return index < 1 || index > std::numeric_limits<std::uint32_t>::max() ? 0 : static_cast<std::uint32_t>(index);
  }

  Result<void> take_face(std::string_view rest) {
    corners_.clear();
    corner_uvs_.clear();
    corner_normals_.clear();
    for (std::string_view token = text::take_token(rest); !token.empty(); token = text::take_token(rest)) {
      const auto stated = text::integer_from_token(token.substr(0, std::min(token.find('/'), token.size())));
      // Negative: counted back from the vertex read last.
      const std::int64_t index = stated && *stated < 0 ? vertex_count() + 1 + *stated : stated.value_or(0);
      if (!stated || index < 1 || index > static_cast<std::int64_t>(kMaxSurfaceVertices)) {
        return corrupt_at(lines_.number(), "a face refers to vertex " + quoted(token) +
                                               "; indices count from 1, or back from -1, to a vertex of the file");
      }
      if (index > largest_index_) {
        largest_index_ = index;
        line_of_largest_ = lines_.number();
      }
      corners_.push_back(static_cast<std::uint32_t>(index - 1));
      corner_uvs_.push_back(number_in(token, 1, uvs_.size()));
      corner_normals_.push_back(number_in(token, 2, normals_.size()));
    }
    if (const auto corners = check_corners(corners_.size(), lines_.number()); !corners) return corners.error();
    add_fan(corners_, mesh_.surface.faces);
    add_fan(corner_uvs_, face_uvs_);
    add_fan(corner_normals_, face_normals_);
    mesh_.material.resize(mesh_.surface.faces.size(), material_);
    any_material_ |= material_ >= 0;
    return {};
  }

  // At the end, because faces may refer to UVs that follow them.
  void resolve_uvs() {
    const auto is_stated = [](const Face& uvs) { return uvs != Face{0, 0, 0}; };
    if (std::none_of(face_uvs_.begin(), face_uvs_.end(), is_stated)) return;
    const auto uv = [&](std::uint32_t number) {
      return number == 0 || number > uvs_.size() ? std::array<float, 2>{kNoUv, kNoUv} : uvs_[number - 1];
    };
    for (const Face& numbers : face_uvs_) {
      mesh_.corner_uv.push_back({uv(numbers[0]), uv(numbers[1]), uv(numbers[2])});
    }
  }

  void resolve_normals() {
    if (normals_.empty()) return;
    VertexNormalsFinder finder(mesh_.surface.vertex_count());
    for (std::size_t f = 0; f < face_normals_.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t number = face_normals_[f][k];
        Vec3 normal{};
        if (number > 0 && number <= normals_.size()) std::copy_n(normals_[number - 1].begin(), 3, normal.begin());
        finder.add_corner(mesh_.surface.faces[f][k], normal);
      }
    }
    mesh_.normals = finder.take();
  }

  text::Lines lines_;
  ParsedMesh mesh_;
  std::vector<std::uint32_t> corners_, corner_uvs_, corner_normals_;  // of the face at hand; the last two from 1
  std::vector<std::array<float, 2>> uvs_;
  std::vector<std::array<float, 3>> normals_;
  std::vector<Face> face_uvs_, face_normals_;  // of each triangle
  std::map<std::string, int> number_of_material_;
  int material_ = -1;
  bool any_material_ = false;
  std::int64_t largest_index_ = 0;
  std::size_t line_of_largest_ = 0;
};

constexpr std::size_t kMaxFiles = 64;
constexpr std::size_t kMaxTextBytes = std::size_t{16} << 20;

struct Material {
  std::array<float, 3> colour{1, 1, 1};
  std::string image;
};

/// Errors: what is wrong with it, by its name.
Result<std::string> bytes_below(const std::string& folder, const std::string& name, std::size_t most) {
  const std::string path = (fs::path(folder) / name).string(), called = quoted_name(name);
  std::error_code code;
  if (!fs::exists(path, code)) return fail(ErrorCode::kNotFound, called + " is not there");
  if (!text::is_file_below(folder, path))
    return fail(ErrorCode::kUnsupported, called + " is not a file below the model's folder");
  if (fs::file_size(path, code) > most || code)
    return fail(ErrorCode::kTooLarge, called + " has more than " + std::to_string(most >> 20) + " MiB");
  auto bytes = text::bytes_of_file(path);
  if (!bytes) return fail(bytes.error().code, called + " cannot be read");
  return bytes;
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

Result<ParsedMesh> parse_obj(std::string_view bytes) {
  return ObjParser(bytes).run();
}

void add_obj_appearance(const ParsedMesh& mesh, const std::string& path, Appearance& appearance) {
  appearance = {};
  appearance.vertex_colour = mesh.colours;
  appearance.vertex_normals = mesh.normals;
  appearance.corner_uv = mesh.corner_uv;
  if (mesh.material.empty() || mesh.material_files.size() > kMaxFiles) return;
  const fs::path parent = fs::path(path).parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  std::map<std::string, Material, std::less<>> materials;
  std::vector<std::string> missing;
  for (const std::string& name : mesh.material_files) {
    if (const auto bytes = bytes_below(folder, name, kMaxTextBytes))
      read_library(*bytes, materials);
    else
      missing.push_back(path + ": " + bytes.error().message + ": drawn without its colours and textures");
  }
  const auto is_found = [&](const std::string& name) { return materials.contains(name); };
  if (!std::all_of(mesh.material_names.begin(), mesh.material_names.end(), is_found))
    appearance.missing = std::move(missing);
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
        Appearance::Image read{at->second.image, "", {}};
        const auto bytes = bytes_below(folder, read.name, kMaxImageBytes);
        if (bytes) read.bytes.assign(bytes->begin(), bytes->end());
        const Result<void> usable = bytes ? check_image(read) : Result<void>(bytes.error());
        if (!usable) appearance.missing.push_back(path + ": " + usable.error().message + ": drawn without it");
        appearance.images.push_back(std::move(read));
      }
    }
    appearance.materials.push_back(std::move(mine));
  }
  note_other_images(appearance);
}

}  // namespace eigencast
