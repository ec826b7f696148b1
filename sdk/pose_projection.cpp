// SPDX-License-Identifier: MIT
#include "sdk/pose_projection.h"

#include <algorithm>
#include <string>
#include <utility>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

/// A quarter of a key interval: so coarse that velocities cost few bits, so fine that their rounding moves a pose
/// between two keys (by at most 4/27 of an interval's movement) less than that of the keys does.
std::uint32_t velocity_unit(double key_rate_hz) {
  const double us = key_rate_hz > 0 ? 1e6 / key_rate_hz / 4 : 0;
  return static_cast<std::uint32_t>(std::clamp(us, 1000.0, static_cast<double>(limits::kMaxVelocityUs)));
}

}  // namespace

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
  if (const auto ready = prepare(); !ready) return ready.error();
  Coefficients out;
  if (const auto good = store(out.C, projector_->coefficients_from_positions(pose.positions)); !good)
    return good.error();
  if (!pose.velocities.empty()) {
    const auto good = store(out.V, projector_->coefficients_from_vectors(pose.velocities));
    if (!good) return in_context("velocities", good.error());
  }
  if (!pose.scalars.empty()) {
    const auto good = store(out.S, project_scalars(pose.scalars));
    if (!good) return in_context("scalars", good.error());
  }
  return out;
}

Result<void> PoseProjection::prepare() {
  if (projector_) return {};
  auto made = Projector::create(*asset_);
  if (!made) return made.error();
  projector_ = std::move(*made);
  return {};
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

double error_bound(const PublisherOptions& options, const Asset& asset) {
  if (options.error > 0) return options.error;
  return asset.coding_error > 0 ? asset.coding_error : kDefaultErrorOverDiagonal * asset.diagonal();
}

StreamFormat format_of(const PublisherOptions& options, const Asset& asset) {
  StreamFormat format{asset.rank, 3, asset.band_ends, std::string(name_of(options.codec))};
  for (const auto& [name, unit, low, high, error] : options.scalars) {
    const double own = error != 0 ? error : kDefaultErrorOverDiagonal * (high - low);
    const bool scaled = own != 0 && options.codec == CodecKind::kQuantised;
    format.scalars.push_back({name, unit, low, high, scaled ? error_bound(options, asset) / own : 1});
    ++format.channels;
  }
  if (options.velocities) {
    format.channels += 3;
    format.velocity_channels = 3;
    format.velocity_us = velocity_unit(options.key_rate_hz);
  }
  return format;
}

std::vector<double> rows_in_format(const StreamFormat& format, std::span<const double> C, std::span<const double> V,
                                   std::span<const double> S) {
  const std::size_t r = format.rows, c = format.channels, s = c - 3 - format.velocity_channels;
  if (C.size() != 3 * r || (!V.empty() && V.size() != C.size())) return {};
  std::vector<double> all(r * c);
  const double unit_s = format.velocity_us * 1e-6;
  for (std::size_t row = 0; row < r; ++row) {
    double* to = &all[row * c];
    std::copy_n(&C[3 * row], 3, to);
    for (std::size_t k = 0; k < s; ++k) to[3 + k] = S[row * s + k] * format.scalars[k].scale;
    for (std::size_t axis = 0; !V.empty() && axis < 3; ++axis) to[3 + s + axis] = V[3 * row + axis] * unit_s;
  }
  return all;
}

}  // namespace eigencast
