// SPDX-License-Identifier: MIT
#include "sender/surface_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/surface/checks/surface_distance.h"

namespace eigencast {

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

SourceRebuilder::SourceRebuilder(const Asset& asset)
    : asset_(asset), rows_(std::size_t{3} * asset.vertex_count), positions_(asset.vertex_count) {
  reconstructor_.update(asset);
}

std::span<const Vec3> SourceRebuilder::rebuild(std::span<const double> C, std::uint32_t channels) {
  reconstructor_.rebuild(C, channels, asset_.rank, asset_.vertex_count, rows_);
  for (std::size_t row = 0; row < positions_.size(); ++row) {
    Vec3& vertex = positions_[asset_.source_vertex[row]];
    for (std::size_t axis = 0; axis < 3; ++axis) vertex[axis] = double{rows_[3 * row + axis]} + asset_.origin[axis];
  }
  return positions_;
}

}  // namespace eigencast
