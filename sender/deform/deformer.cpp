// SPDX-License-Identifier: MIT
#include "sender/deform/deformer.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <string>

#include "common/core/worker_team.h"

namespace eigencast::deform {

std::vector<Vec3> applied(const LinearMap& map, std::span<const double> y) {
  constexpr std::size_t kRowsPerTask = 64;
  assert(y.size() == 3 * map.controls);
  std::vector<Vec3> positions(map.vertices);
  for_each_shared(map.vertices, kRowsPerTask, [&](std::size_t i) {
    const double* row = &map.W[i * map.controls];
    Vec3 p{};
    for (std::size_t c = 0; c < map.controls; ++c) {
      for (std::size_t axis = 0; axis < 3; ++axis) p[axis] += row[c] * y[3 * c + axis];
    }
    positions[i] = p;
  });
  return positions;
}

Result<ProjectedDeformer> ProjectedDeformer::create(Deformer& deformer, const Asset& asset,
                                                    const Projector& projector) {
  ProjectedDeformer projected(deformer, projector);
  projected.rank_ = asset.rank;
  const LinearMap* map = deformer.linear_map();
  if (map == nullptr) return projected;
  if (map->vertices != asset.vertex_count) {
    return fail(ErrorCode::kInvalidArgument, "the deformer has " + std::to_string(map->vertices) +
                                                 " vertices, the asset " + std::to_string(asset.vertex_count));
  }
  if (const auto done = projected.project_weights(*map, asset); !done) return done.error();
  return projected;
}

Result<void> ProjectedDeformer::project_weights(const LinearMap& map, const Asset& asset) {
  const std::size_t n = map.vertices, c = map.controls;
  controls_ = c;
  P_.resize(rank_ * c);
  offset_.resize(rank_ * 3);
  std::vector<double> columns(3 * n);  // as many as the projector takes at a time
  const auto project = [&](const auto& value_of) {
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t k = 0; k < 3; ++k) columns[3 * i + k] = value_of(i, k);
    }
    return projector_->coefficients_from_vectors(std::span<const double>(columns));
  };
  for (std::size_t first = 0; first < c; first += 3) {
    const auto C =
        project([&](std::size_t i, std::size_t k) { return first + k < c ? map.W[i * c + first + k] : 0.0; });
    if (!C) return C.error();
    for (std::size_t row = 0; row < rank_; ++row) {
      for (std::size_t k = 0; k < 3 && first + k < c; ++k) P_[row * c + first + k] = (*C)[3 * row + k];
    }
  }
  const auto ones = project([](std::size_t, std::size_t) { return 1.0; });
  if (!ones) return ones.error();
  for (std::size_t row = 0; row < rank_; ++row) {
    for (std::size_t k = 0; k < 3; ++k) offset_[3 * row + k] = (*ones)[3 * row] * asset.origin[k];
  }
  return {};
}

Result<std::vector<double>> ProjectedDeformer::coefficients(std::span<const Vec3> moved) {
  if (deformer_->makes_coefficients()) return deformer_->coefficients(moved);
  if (P_.empty()) {
    const std::vector<Vec3> pose = deformer_->positions(moved);
    return projector_->coefficients_from_positions(std::span<const double>(pose.front().data(), 3 * pose.size()));
  }
  const std::vector<double> y = deformer_->controls(moved);
  assert(y.size() == 3 * controls_);
  if (!std::all_of(y.begin(), y.end(), [](double value) { return std::isfinite(value); }))
    return fail(ErrorCode::kInvalidArgument, "a handle's position is not a finite number");
  std::vector<double> C(3 * rank_);
  for (std::size_t row = 0; row < rank_; ++row) {
    double sums[3] = {-offset_[3 * row], -offset_[3 * row + 1], -offset_[3 * row + 2]};
    const double* weights = &P_[row * controls_];
    for (std::size_t k = 0; k < controls_; ++k) {
      for (std::size_t axis = 0; axis < 3; ++axis) sums[axis] += weights[k] * y[3 * k + axis];
    }
    std::copy_n(sums, 3, &C[3 * row]);
  }
  return C;
}

}  // namespace eigencast::deform
