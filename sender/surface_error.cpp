// SPDX-License-Identifier: MIT
#include "sender/surface_error.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast {

void SurfaceErrorSum::add(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  assert(truth.size() == rebuilt.size());
  kg_.add_frame(truth, rebuilt);
  for (std::size_t i = 0; i < truth.size(); ++i) {
    double squared = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double difference = truth[i][axis] - rebuilt[i][axis];
      squared += difference * difference;
    }
    sum_squared_ += squared;
    max_squared_ = std::max(max_squared_, squared);
  }
  vertices_ += truth.size();
  ++poses_;
}

SurfaceError SurfaceErrorSum::result() const {
  if (poses_ == 0) return {};
  return {poses_, kg_.percent(), std::sqrt(sum_squared_ / static_cast<double>(vertices_)) / diagonal_,
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
