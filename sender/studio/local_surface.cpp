// SPDX-License-Identifier: MIT
#include "sender/studio/local_surface.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast::studio {
namespace {

/// W in the asset's order as the basis of an asset, so that the reconstruction kernel computes X = W y.
Asset as_asset(const Asset& asset, const deform::LinearMap& map) {
  Asset wrapped;
  const std::size_t n = map.vertices, c = map.controls;
  wrapped.vertex_count = wrapped.rows_ready = static_cast<std::uint32_t>(n);
  wrapped.rank = static_cast<std::uint32_t>(c);
  wrapped.floats.resize(n * c);
  for (std::size_t row = 0; row < n; ++row) {
    const double* from = &map.W[asset.source_vertex[row] * c];
    std::transform(from, from + c, &wrapped.floats[row * c], [](double w) { return static_cast<float>(w); });
  }
  return wrapped;
}

}  // namespace

LocalSurface::LocalSurface(const Asset& asset, const deform::LinearMap* map) : asset_(&asset) {
  assert(asset.complete() && (map == nullptr || map->vertices == asset.vertex_count));
  received_.update(asset);
  if (map != nullptr) full_.update(as_asset(asset, *map));
  received_positions_.resize(std::size_t{3} * asset.vertex_count);
  if (map != nullptr) full_positions_.resize(received_positions_.size());
  geometry_.triangles = triangles_at_level(asset, asset.vertex_count);
  geometry_.topology_version = 1;
  geometry_.is_point_cloud = asset.is_point_cloud();
  if (geometry_.is_point_cloud)
    geometry_.point_spacing = static_cast<float>(std::sqrt(asset.area / asset.vertex_count));
}

void LocalSurface::set(std::span<const double> y, std::span<const double> C) {
  received_.rebuild(C, 3, asset_->rank, asset_->vertex_count, received_positions_);
  if (!full_positions_.empty()) {
    full_.rebuild(y, 3, full_.tiles().rank(), asset_->vertex_count, full_positions_);
    compare();
  }
  geometry_.positions = received_shown() ? received_positions_ : full_positions_;
  if (!geometry_.is_point_cloud) {
    geometry_.normals.resize(geometry_.positions.size());
    vertex_normals(geometry_.positions, geometry_.triangles, geometry_.normals);
  }
  ++geometry_.pose_version;
}

void LocalSurface::compare() {
  double sum = 0, largest = 0;
  for (std::size_t i = 0; i < full_positions_.size(); i += 3) {
    double squared = 0;
    for (std::size_t k = i; k < i + 3; ++k) {
      const double d = double{full_positions_[k]} - double{received_positions_[k]};
      squared += d * d;
    }
    sum += squared;
    largest = std::max(largest, squared);
  }
  const double diagonal = asset_->diagonal();
  rms_ = std::sqrt(sum / asset_->vertex_count) / diagonal;
  max_ = std::sqrt(largest) / diagonal;
}

}  // namespace eigencast::studio
