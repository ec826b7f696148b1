// SPDX-License-Identifier: MIT
#include "sdk/pose_projection.h"

#include <algorithm>
#include <string>
#include <utility>

namespace eigencast {

Result<PoseProjection::Coefficients> PoseProjection::project(const VertexPose& pose) {
  if (pose.velocities.empty() == velocities_) {
    return fail(ErrorCode::kInvalidArgument,
                pose.velocities.empty()
                    ? "this publisher was made for velocities: give those of the vertices as well"
                    : "this publisher was not made for velocities: set PublisherOptions::velocities");
  }
  if (pose.scalars.size() != std::size_t{asset_->vertex_count} * scalars_) {
    return fail(ErrorCode::kInvalidArgument, "this publisher was made for " + std::to_string(scalars_) +
                                                 " scalars of each vertex; " + std::to_string(pose.scalars.size()) +
                                                 " values are given in all");
  }
  if (!projector_) {
    auto made = Projector::create(*asset_);
    if (!made) return made.error();
    projector_ = std::move(*made);
  }
  Coefficients out;
  auto positions = projector_->coefficients_from_positions(pose.positions);
  if (!positions) return positions.error();
  out.C = std::move(*positions);
  if (!pose.velocities.empty()) {
    auto velocities = projector_->coefficients_from_vectors(pose.velocities);
    if (!velocities) return in_context("velocities", velocities.error());
    out.V = std::move(*velocities);
  }
  if (!pose.scalars.empty()) {
    auto scalars = project_scalars(pose.scalars);
    if (!scalars) return in_context("scalars", scalars.error());
    out.S = std::move(*scalars);
  }
  return out;
}

Result<std::vector<double>> PoseProjection::project_scalars(std::span<const float> values) const {
  const std::size_t n = asset_->vertex_count, s = scalars_, r = asset_->rank;
  std::vector<double> S(r * s);
  std::vector<float> columns(3 * n);
  for (std::size_t first = 0; first < s; first += 3) {
    const std::size_t count = std::min<std::size_t>(3, s - first);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t k = 0; k < 3; ++k) columns[3 * i + k] = k < count ? values[i * s + first + k] : 0;
    }
    auto C = projector_->coefficients_from_vectors(columns);
    if (!C) return C.error();
    for (std::size_t row = 0; row < r; ++row) std::copy_n(&(*C)[3 * row], count, &S[row * s + first]);
  }
  return S;
}

}  // namespace eigencast
