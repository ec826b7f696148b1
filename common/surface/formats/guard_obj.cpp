// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/guard.h"

namespace eigencast {
namespace {

using text::corrupt_at;
using text::quoted;

constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();

class ObjGuard {
 public:
  explicit ObjGuard(std::string_view bytes) : lines_(bytes) {}

  Result<GuardedMesh> run() {
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
      if (keyword == "vt") take_place(rest);
      if (keyword == "usemtl") take_material(rest);
      if (keyword == "mtllib") mesh_.material_files.emplace_back(text::trimmed(rest));
      if (!taken) return taken.error();
    }
    if (!joined.empty()) return corrupt_at(lines_.number(), "the file ends where a line should go on");
    if (largest_index_ > vertex_count()) {
      return corrupt_at(line_of_largest_, "a face refers to vertex " + std::to_string(largest_index_) +
                                              ", but there are " + std::to_string(vertex_count()));
    }
    if (const auto sizes = check_sizes(mesh_.positions.size(), mesh_.triangles); !sizes) return sizes.error();
    if (const auto written = write_faces(); !written) return written.error();
    drop_partial_colours(mesh_);
    write_looks();
    return std::move(mesh_);
  }

 private:
  std::int64_t vertex_count() const { return static_cast<std::int64_t>(mesh_.positions.size()); }

  Result<void> take_vertex(std::string_view rest) {
    Vec3 p{};
    mesh_.plain += 'v';
    for (double& coordinate : p) {
      const std::string_view token = text::take_token(rest);
      const auto value = text::coordinate_from_token(token);
      if (!value) return corrupt_at(lines_.number(), "a vertex needs three finite numbers, not " + quoted(token));
      coordinate = *value;
      mesh_.plain.append(" ").append(token);
    }
    mesh_.plain += '\n';
    mesh_.positions.push_back(p);
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

  // Numbers that are none leave a place that is nowhere, so that the others keep their numbers.
  void take_place(std::string_view rest) {
    std::array<float, 2> uv{kNowhere, kNowhere};
    const auto u = text::coordinate_from_token(text::take_token(rest));
    const std::string_view second = text::take_token(rest);
    const auto v = second.empty() ? std::optional<double>(0) : text::coordinate_from_token(second);
    // Images begin below here, and above everywhere else.
    if (u && v) uv = {static_cast<float>(*u), static_cast<float>(1 - *v)};
    places_.push_back(uv);
  }

  void take_material(std::string_view rest) {
    const std::string name(text::trimmed(rest));
    const auto [at, fresh] = number_of_material_.try_emplace(name, static_cast<int>(mesh_.material_names.size()));
    if (fresh) mesh_.material_names.push_back(name);
    material_ = at->second;
  }

  // The number of the place in "7/8/9", from 1; 0 where none is stated.
  std::int64_t place_of(std::string_view token) const {
    const std::size_t slash = token.find('/');
    if (slash == std::string_view::npos) return 0;
    const std::string_view rest = token.substr(slash + 1);
    const auto stated = text::integer_from_token(rest.substr(0, std::min(rest.find('/'), rest.size())));
    const auto count = static_cast<std::int64_t>(places_.size());
    const std::int64_t index = !stated ? 0 : *stated < 0 ? count + 1 + *stated : *stated;
    return index < 1 || index > static_cast<std::int64_t>(std::numeric_limits<std::uint32_t>::max()) ? 0 : index;
  }

  // Places and materials of the triangles, in fans as OpenMesh makes them.
  void write_looks() {
    const bool any_place = std::any_of(corner_places_.begin(), corner_places_.end(), [](auto at) { return at != 0; });
    const bool any_material = std::any_of(face_material_.begin(), face_material_.end(), [](int m) { return m >= 0; });
    const auto place = [&](std::size_t corner) {
      const std::uint32_t at = corner_places_[corner];
      return at == 0 || at > places_.size() ? std::array<float, 2>{kNowhere, kNowhere} : places_[at - 1];
    };
    std::size_t first = 0;
    for (std::size_t f = 0; f < corner_counts_.size(); ++f) {
      for (std::size_t k = 2; k < corner_counts_[f]; ++k) {
        if (any_place) mesh_.corner_uv.push_back({place(first), place(first + k - 1), place(first + k)});
        if (any_material) mesh_.material.push_back(face_material_[f]);
      }
      first += corner_counts_[f];
    }
  }

  Result<void> take_face(std::string_view rest) {
    std::size_t count = 0;
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
      corners_.push_back(static_cast<std::uint32_t>(index));
      corner_places_.push_back(static_cast<std::uint32_t>(place_of(token)));
      ++count;
    }
    if (const auto corners = check_corners(count, lines_.number()); !corners) return corners.error();
    corner_counts_.push_back(static_cast<std::uint32_t>(count));
    face_material_.push_back(material_);
    mesh_.triangles += count - 2;
    return {};
  }

  // OpenMesh's OBJ reader takes repeated corners out of a face, which changes the number of triangles. So the k-th
  // repetition of a corner goes under the alias index + k * n, which the importer takes back modulo n.
  Result<void> write_faces() {
    const std::uint64_t n = mesh_.positions.size();
    std::vector<std::uint32_t> sorted;
    std::size_t first = 0;
    for (const std::uint32_t count : corner_counts_) {
      const auto begin = corners_.begin() + static_cast<std::ptrdiff_t>(first);
      sorted.assign(begin, begin + count);
      std::sort(sorted.begin(), sorted.end());
      const bool repeats = std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end();
      mesh_.plain += 'f';
      for (auto corner = begin; corner != begin + count; ++corner) {
        std::uint64_t alias = *corner;
        if (repeats) alias += n * static_cast<std::uint64_t>(std::count(begin, corner, *corner));
        if (alias > std::numeric_limits<std::int32_t>::max()) {
          return fail(ErrorCode::kTooLarge, "a face repeats vertex " + std::to_string(*corner) + " too often");
        }
        mesh_.plain.append(" ").append(std::to_string(alias));
      }
      mesh_.plain += '\n';
      first += count;
    }
    return {};
  }

  text::Lines lines_;
  GuardedMesh mesh_;
  std::vector<std::uint32_t> corners_;
  std::vector<std::uint32_t> corner_counts_;
  std::vector<std::array<float, 2>> places_;
  std::vector<std::uint32_t> corner_places_;  // from 1
  std::vector<int> face_material_;
  std::map<std::string, int> number_of_material_;
  int material_ = -1;
  std::int64_t largest_index_ = 0;
  std::size_t line_of_largest_ = 0;
};

}  // namespace

Result<void> check_sizes(std::size_t vertices, std::size_t triangles) {
  if (vertices == 0) return fail(ErrorCode::kCorrupt, "no vertices in it");
  if (vertices > kMaxSurfaceVertices || triangles > kMaxSurfaceFaces) {
    return fail(ErrorCode::kTooLarge, std::to_string(vertices) + " vertices and " + std::to_string(triangles) +
                                          " triangles; the limits are " + std::to_string(kMaxSurfaceVertices) +
                                          " and " + std::to_string(kMaxSurfaceFaces));
  }
  return {};
}

std::array<std::uint8_t, 3> colour_from_parts(const std::array<double, 3>& parts) {
  std::array<std::uint8_t, 3> colour{};
  for (std::size_t c = 0; c < 3; ++c)
    colour[c] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(parts[c], 0.0, 1.0)));
  return colour;
}

void drop_partial_colours(GuardedMesh& mesh) {
  if (mesh.colours.size() != mesh.positions.size()) mesh.colours.clear();
}

Result<void> check_corners(std::uint64_t corners, std::size_t line) {
  if (corners >= 3 && corners <= kMaxCorners) return {};
  const std::string where = line > 0 ? "line " + std::to_string(line) + ": " : "";
  return fail(
      corners < 3 ? ErrorCode::kCorrupt : ErrorCode::kTooLarge,
      where + "a face of " + std::to_string(corners) + " corners; 3 to " + std::to_string(kMaxCorners) + " can be");
}

Result<GuardedMesh> guard_obj(std::string_view bytes) {
  return ObjGuard(bytes).run();
}

}  // namespace eigencast
