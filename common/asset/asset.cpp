// SPDX-License-Identifier: MIT
#include "common/asset/asset.h"

#include <algorithm>
#include <cmath>

#include "common/asset/asset_limits.h"

namespace eigencast {
namespace {

constexpr float kGridSteps = 65534;

Error corrupt_asset(std::string what) {
  return fail(ErrorCode::kCorrupt, std::move(what));
}

Result<void> check_shapes(const Asset& a) {
  const std::size_t n = a.vertex_count;
  const std::size_t r = a.rank;
  const auto wrong = [](const char* name, std::size_t size, std::size_t expected) {
    return corrupt_asset(std::string(name) + " has " + std::to_string(size) + " entries instead of " +
                         std::to_string(expected));
  };
  if (a.column_scales.size() > r ||
      !std::all_of(a.column_scales.begin(), a.column_scales.end(), asset_limits::is_column_scale)) {
    return corrupt_asset("its column scales do not belong to its columns");
  }
  const std::size_t f = a.float_columns();
  if (a.floats.size() != n * f) return wrong("floats", a.floats.size(), n * f);
  if (a.integers.size() != n * (r - f)) return wrong("integers", a.integers.size(), n * (r - f));
  if (a.mass.size() != n) return wrong("mass", a.mass.size(), n);
  if (a.map.size() != n) return wrong("map", a.map.size(), n);
  if (a.source_vertex.size() != n) return wrong("source_vertex", a.source_vertex.size(), n);
  if (a.faces.size() != a.face_total) return wrong("faces", a.faces.size(), a.face_total);
  if (a.death.size() != a.face_total) return wrong("death", a.death.size(), a.face_total);
  if (a.rows_ready != n || a.faces_ready != a.face_total) return corrupt_asset("not all of it has arrived");
  return {};
}

Result<void> check_rows(const Asset& a) {
  std::vector<bool> seen(a.vertex_count, false);
  for (std::uint32_t i = 0; i < a.vertex_count; ++i) {
    const auto row = [i] { return "row " + std::to_string(i); };
    if (i < a.base_count ? a.map[i] != i : a.map[i] >= i)
      return corrupt_asset(row() + " maps to " + std::to_string(a.map[i]));
    if (a.source_vertex[i] >= a.vertex_count || seen[a.source_vertex[i]])
      return corrupt_asset(row() + ": source_vertex is not a permutation");
    seen[a.source_vertex[i]] = true;
    if (!std::isfinite(a.mass[i]) || a.mass[i] <= 0) return corrupt_asset(row() + ": its mass is not positive");
    for (std::uint32_t k = 0; k < a.rank; ++k) {
      if (!std::isfinite(a.entry(i, k)))
        return corrupt_asset(row() + ": basis column " + std::to_string(k) + " is not finite");
    }
  }
  return {};
}

Result<void> check_faces(const Asset& a) {
  for (std::size_t f = 0; f < a.faces.size(); ++f) {
    const auto face = [f] { return "face " + std::to_string(f); };
    const auto& [x, y, z] = a.faces[f];
    if (x >= a.vertex_count || y >= a.vertex_count || z >= a.vertex_count)
      return corrupt_asset(face() + " has a corner beyond the vertices");
    if (x == y || y == z || z == x) return corrupt_asset(face() + " repeats a corner");
    if (a.death[f] >= a.vertex_count || (f > 0 && a.death[f] < a.death[f - 1]))
      return corrupt_asset(face() + ": its death is out of order");
  }
  return {};
}

Result<void> check_splats(const Asset& a) {
  const Asset::Splats& s = a.splats;
  if (s.size() == 0) return {};
  const std::size_t n = a.vertex_count;
  if (!a.is_point_cloud()) return corrupt_asset("it has faces and splats");
  if (s.size() != n || s.normal.size() != n || s.radius.size() != n || s.parent_radius.size() != n) {
    return corrupt_asset("there are splats, but not one for each row");
  }
  for (std::uint32_t i = 0; i < n; ++i) {
    const std::uint32_t end = std::max(a.base_count, i + 1);
    const float squared =
        s.normal[i][0] * s.normal[i][0] + s.normal[i][1] * s.normal[i][1] + s.normal[i][2] * s.normal[i][2];
    if (s.frame[i][0] >= end || s.frame[i][1] >= end || !(std::abs(squared - 1) < 1e-3F) || !(s.radius[i] >= 0) ||
        !(s.parent_radius[i] >= 0)) {
      return corrupt_asset("the splat of row " + std::to_string(i) + " is out of its range");
    }
  }
  return {};
}

Result<void> check_detail(const Asset& a) {
  const Asset::Detail& d = a.detail;
  if (d.size() == 0) return {};
  const std::size_t n = a.vertex_count, entries = n * a.rank;
  if (d.axes != 1 && d.axes != 3)
    return corrupt_asset("its detail has " + std::to_string(d.axes) + " axes, not 1 or 3");
  if (d.size() != n || d.normal.size() != n || d.along_x.size() != entries || d.along_y.size() != entries ||
      d.steps.size() != a.rank || !std::all_of(d.steps.begin(), d.steps.end(), asset_limits::is_column_scale)) {
    return corrupt_asset("there is detail, but not for each row and column");
  }
  for (std::uint32_t i = 0; i < n; ++i) {
    const auto& [x, y, z] = d.normal[i];
    const auto is_finite = [](float component) { return std::isfinite(component); };
    if (!std::all_of(d.offset[i].begin(), d.offset[i].end(), is_finite) ||
        !(std::abs(x * x + y * y + z * z - 1) < 1e-3F))
      return corrupt_asset("the detail of row " + std::to_string(i) + " is out of its range");
  }
  return {};
}

Result<void> check_colours(const Asset& a) {
  if (a.colours.empty() || a.colours.size() == a.vertex_count) return {};
  return corrupt_asset("there are colours, but not one for each row");
}

Result<void> check_normals(const Asset& a) {
  const auto is_known = [](std::uint8_t value) { return value < Asset::kNormalsValues; };
  if (a.normals.empty()) return {};
  if (a.normals.size() == a.vertex_count && std::all_of(a.normals.begin(), a.normals.end(), is_known)) return {};
  return corrupt_asset("there are normals, but not one of three values for each row");
}

}  // namespace

std::array<float, 2> AssetTexture::uv(std::uint32_t wedge) const {
  std::array<float, 2> at{};
  for (std::size_t d = 0; d < 2; ++d)
    at[d] = low[d] + (high[d] - low[d]) * (static_cast<float>(uvs[wedge][d]) / kGridSteps);
  return at;
}

std::uint16_t texture_grid(float value, float low, float high) {
  return high > low ? static_cast<std::uint16_t>(std::lround(kGridSteps * ((value - low) / (high - low)))) : 0;
}

bool AssetTexture::has_finite_box() const {
  const auto is_small = [](float value) { return std::abs(value) <= 1e30F; };
  return is_small(low[0]) && is_small(low[1]) && is_small(high[0]) && is_small(high[1]) && low[0] <= high[0] &&
         low[1] <= high[1];
}

void Asset::Splats::append(const Splats& more) {
  const auto add = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
  add(frame, more.frame);
  add(normal, more.normal);
  add(radius, more.radius);
  add(parent_radius, more.parent_radius);
}

void Asset::Splats::resize(std::size_t rows) {
  frame.resize(rows);
  normal.resize(rows);
  radius.resize(rows);
  parent_radius.resize(rows);
}

void Asset::copy_row(std::size_t row, std::span<float> to) const {
  const std::size_t count = float_columns(), width = column_scales.size();
  std::copy_n(floats.begin() + static_cast<std::ptrdiff_t>(row * count), count, to.begin());
  const std::int16_t* const from = integers.data() + row * width;
  for (std::size_t k = 0; k < width; ++k) to[count + k] = static_cast<float>(from[k]) * column_scales[k];
}

double AssetFacts::diagonal() const {
  return std::hypot(box_high[0] - box_low[0], box_high[1] - box_low[1], box_high[2] - box_low[2]);
}

Result<void> check_counts(const AssetFacts& a) {
  if (a.vertex_count == 0 || a.rank == 0) return corrupt_asset("no vertices or no basis columns");
  const auto within = [](const char* what, std::uint64_t value, std::uint64_t limit) {
    return value <= limit ? Result<void>()
                          : fail(ErrorCode::kTooLarge, std::string(what) + " is " + std::to_string(value) +
                                                           ", over the limit of " + std::to_string(limit));
  };
  using namespace asset_limits;
  if (auto ok = within("vertex count", a.vertex_count, kMaxVertices); !ok) return ok;
  if (auto ok = within("face count", a.face_total, kMaxFaces); !ok) return ok;
  if (auto ok = within("rank", a.rank, kMaxRank); !ok) return ok;
  const std::uint64_t decoded = std::uint64_t{a.vertex_count} * a.rank * sizeof(float);
  if (auto ok = within("size of the basis", decoded, kMaxDecodedBytes); !ok) return ok;
  if (a.base_count >= 1 && a.base_count <= a.vertex_count) return {};
  return corrupt_asset("base count " + std::to_string(a.base_count) + " is not within 1 and n");
}

Result<void> check_facts(const AssetFacts& a) {
  if (auto counts = check_counts(a); !counts) return counts;
  if (a.name.size() > asset_limits::kMaxNameBytes || a.basis_kind.size() > asset_limits::kMaxKindBytes ||
      a.operator_kind.size() > asset_limits::kMaxKindBytes || a.level_errors.size() > asset_limits::kMaxLevelErrors)
    return fail(ErrorCode::kTooLarge, "its name, a kind or its list of levels is too long");
  std::uint32_t least = a.base_count;
  for (const GeometricError& error : a.level_errors) {
    if (error.rows < least || error.rows >= a.vertex_count || !(error.rms >= 0 && error.rms <= error.largest) ||
        !std::isfinite(error.largest))
      return corrupt_asset("the error of level " + std::to_string(error.rows) + " is out of range");
    least = error.rows + 1;
  }
  if (a.band_ends.empty() || a.band_ends.size() > asset_limits::kMaxBands || a.band_ends.back() != a.rank)
    return corrupt_asset("bands must be 1 to 8 and end at the rank");
  for (std::size_t b = 0; b < a.band_ends.size(); ++b) {
    if (a.band_ends[b] <= (b == 0 ? 0 : a.band_ends[b - 1]))
      return corrupt_asset("band " + std::to_string(b) + " is empty");
  }
  if (a.rest.size() != std::size_t{a.rank} * 3) return corrupt_asset("rest does not have 3 coefficients a column");
  for (std::size_t i = 0; i < a.rest.size(); ++i) {
    if (!std::isfinite(a.rest[i])) return corrupt_asset("rest coefficient " + std::to_string(i / 3) + " is not finite");
  }
  if (!std::isfinite(a.area) || a.area <= 0) return corrupt_asset("the area is not positive");
  if (!std::isfinite(a.metres_per_unit) || a.metres_per_unit < 0)
    return corrupt_asset("metres_per_unit is negative or not finite");
  for (std::size_t k = 0; k < 3; ++k) {
    if (!std::isfinite(a.box_low[k]) || !std::isfinite(a.box_high[k]) || a.box_low[k] > a.box_high[k])
      return corrupt_asset("the rest box is not finite or inside out");
    if (!std::isfinite(a.origin[k])) return corrupt_asset("the origin is not finite");
  }
  return {};
}

Result<void> validate_texture(const AssetTexture& t, const Asset& asset) {
  const std::size_t n = asset.vertex_count, W = t.uvs.size();
  if (t.image.size() > AssetTexture::kMaxImageBytes)
    return fail(ErrorCode::kTooLarge, "an image of " + std::to_string(t.image.size()) + " bytes; 16 MiB at most");
  if (t.image.empty() || W == 0) return corrupt_asset("the texture has no image or no wedges");
  if (t.first_wedge.size() != n + 1 || t.first_wedge[0] != 0 || t.first_wedge[n] != W || t.parent.size() != W ||
      t.corners.size() != asset.faces.size() || !std::is_sorted(t.first_wedge.begin(), t.first_wedge.end())) {
    return corrupt_asset("the texture's arrays do not fit the surface");
  }
  if (!t.has_finite_box()) return corrupt_asset("the texture's box is not finite or inside out");
  const auto belongs = [&](std::uint32_t wedge, std::uint32_t row) {
    return wedge >= t.first_wedge[row] && wedge < t.first_wedge[row + 1];
  };
  for (std::uint32_t i = 0; i < n; ++i) {
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      if (i < asset.base_count ? t.parent[w] != w : !belongs(t.parent[w], asset.map[i]))
        return corrupt_asset("wedge " + std::to_string(w) + " has a parent of another vertex");
    }
  }
  for (std::size_t f = 0; f < t.corners.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (!belongs(t.corners[f][k], asset.faces[f][k]))
        return corrupt_asset("face " + std::to_string(f) + " has a wedge of another vertex");
    }
  }
  return {};
}

Result<void> validate_asset(const Asset& asset) {
  if (auto facts = check_facts(asset); !facts) return in_context("asset", facts.error());
  for (auto* check :
       {check_shapes, check_rows, check_faces, check_splats, check_detail, check_colours, check_normals}) {
    if (auto result = check(asset); !result) return in_context("asset", result.error());
  }
  return asset.texture ? validate_texture(*asset.texture, asset) : Result<void>();
}

}  // namespace eigencast
