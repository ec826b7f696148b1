// SPDX-License-Identifier: MIT
#include "sender/surface_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <nlohmann/json.hpp>

namespace eigencast {
namespace {

constexpr int kMaxParts = 64;  // of a triangle's edge between samples

std::vector<Face> faces_of(const Asset& asset, std::uint32_t N) {
  const std::vector<std::uint32_t> corners = triangles_at_level(asset, N);
  std::vector<Face> faces(corners.size() / 3);
  for (std::size_t f = 0; f < faces.size(); ++f) faces[f] = {corners[3 * f], corners[3 * f + 1], corners[3 * f + 2]};
  return faces;
}

double longest_edge(std::span<const Vec3> positions, const Face& face) {
  double squared = 0;
  for (std::size_t k = 0; k < 3; ++k)
    squared = std::max(squared, squared_distance(positions[face[k]], positions[face[(k + 1) % 3]]));
  return std::sqrt(squared);
}

double mean_longest_edge(std::span<const Vec3> positions, std::span<const Face> faces) {
  double sum = 0;
  for (const Face& face : faces) sum += longest_edge(positions, face);
  return faces.empty() ? 0 : sum / static_cast<double>(faces.size());
}

}  // namespace

nlohmann::json json_from(const SurfaceError& error) {
  return {{"poses", error.poses},
          {"kg_percent", error.kg_percent},
          {"rms_over_diagonal", error.rms},
          {"mean_over_diagonal", error.mean},
          {"max_over_diagonal", error.max}};
}

double SurfaceErrorSum::add(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  assert(truth.size() == rebuilt.size());
  kg_.add_frame(truth, rebuilt);
  double pose = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const double squared = squared_distance(truth[i], rebuilt[i]);
    pose += squared;
    sum_ += std::sqrt(squared);
    max_squared_ = std::max(max_squared_, squared);
  }
  sum_squared_ += pose;
  vertices_ += truth.size();
  ++poses_;
  return truth.empty() ? 0 : std::sqrt(pose / static_cast<double>(truth.size())) / diagonal_;
}

SurfaceError SurfaceErrorSum::result() const {
  if (poses_ == 0) return {};
  const auto count = static_cast<double>(vertices_);
  return {poses_, kg_.percent(), std::sqrt(sum_squared_ / count) / diagonal_, sum_ / count / diagonal_,
          std::sqrt(max_squared_) / diagonal_};
}

std::vector<Vec3> rows_of(const Asset& asset, std::span<const Vec3> source) {
  std::vector<Vec3> rows;
  for (const std::uint32_t vertex : asset.source_vertex) rows.push_back(source[vertex] - asset.origin);
  return rows;
}

SourceRebuilder::SourceRebuilder(const Asset& asset)
    : asset_(asset), floats_(std::size_t{3} * asset.vertex_count), positions_(asset.vertex_count) {
  reconstructor_.update(asset);
}

std::vector<Vec3> SourceRebuilder::rebuild_rows(std::span<const double> C, std::uint32_t channels) {
  reconstructor_.rebuild(C, channels, asset_.rank, asset_.vertex_count, floats_);
  std::vector<Vec3> rows(asset_.vertex_count);
  for (std::size_t row = 0; row < rows.size(); ++row) std::copy_n(&floats_[3 * row], 3, rows[row].begin());
  return rows;
}

std::span<const Vec3> SourceRebuilder::rebuild(std::span<const double> C, std::uint32_t channels) {
  const std::vector<Vec3> rows = rebuild_rows(C, channels);
  for (std::size_t row = 0; row < rows.size(); ++row) positions_[asset_.source_vertex[row]] = rows[row] + asset_.origin;
  return positions_;
}

LevelErrorSum::LevelErrorSum(const Asset& asset, double fraction, std::span<const Vec3> rest)
    : asset_(asset),
      level_{fraction, level_from_fraction(asset, fraction), {}, 0, {}},
      faces_(faces_of(asset, level_.vertices)),
      drawn_at_(asset.vertex_count),
      vertex_(asset.diagonal()),
      edges_(level_.vertices, faces_, asset.diagonal()),
      drawn_(rest.first(level_.vertices), faces_) {
  for (std::uint32_t row = 0; row < asset.vertex_count; ++row)
    drawn_at_[row] = row < level_.vertices ? row : drawn_at_[asset.map[row]];
  if (level_.vertices < asset.vertex_count) add_samples(rest);
}

void LevelErrorSum::add_samples(std::span<const Vec3> rest) {
  const double apart = mean_longest_edge(rest, asset_.faces);
  for (const Face& face : faces_) {
    const int parts = std::clamp(static_cast<int>(std::ceil(longest_edge(rest, face) / apart)), 1, kMaxParts);
    for (int i = 0; i <= parts; ++i) {
      for (int j = 0; i + j <= parts; ++j) {
        const int k = parts - i - j;
        if (std::max({i, j, k}) == parts) continue;  // a vertex
        samples_.push_back({face, {i * 1.0 / parts, j * 1.0 / parts, k * 1.0 / parts}});
      }
    }
  }
}

void LevelErrorSum::add(std::span<const Vec3> truth, const SurfaceDistance& surface, std::span<const Vec3> rebuilt) {
  const auto level = rebuilt.first(level_.vertices);
  vertex_.add(truth.first(level_.vertices), level);
  edges_.add(truth.first(level_.vertices), level);

  std::vector<double> bounds(truth.size());
  for (std::size_t row = 0; row < truth.size(); ++row)
    bounds[row] = squared_distance(truth[row], rebuilt[drawn_at_[row]]);
  drawn_.move_to(level);
  double& farthest = squared_hausdorff_;
  farthest = farthest_squared(truth, drawn_, bounds, farthest);
  farthest = farthest_squared(level, surface, std::span(bounds).first(level.size()), farthest);
  std::vector<Vec3> points(samples_.size());
  for (std::size_t s = 0; s < points.size(); ++s) {
    const auto& [corners, weights] = samples_[s];
    for (std::size_t k = 0; k < 3; ++k) points[s] = points[s] + weights[k] * level[corners[k]];
  }
  farthest = farthest_squared(points, surface, {}, farthest);
}

LevelError LevelErrorSum::result() const {
  LevelError level = level_;
  level.vertex = vertex_.result();
  level.edges = edges_.result();
  level.hausdorff = std::sqrt(squared_hausdorff_) / asset_.diagonal();
  return level;
}

}  // namespace eigencast
