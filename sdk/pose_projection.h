// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/publisher.h"

namespace eigencast {

/// Projects a pose's vertices to coefficients of the asset's basis. Not thread-safe.
class PoseProjection {
 public:
  struct Coefficients {
    std::vector<double> C;  ///< r x 3, row-major.
    std::vector<double> V;  ///< r x 3, per second; empty without velocities.
    std::vector<double> S;  ///< r x scalars; empty without.
  };

  PoseProjection(std::shared_ptr<const Asset> asset, bool velocities, std::size_t scalars)
      : asset_(std::move(asset)), velocities_(velocities), scalars_(scalars) {}

  /// Sets up the Projector, which project() does at its first call. Errors: those of the Projector.
  Result<void> prepare();
  /// Errors: kInvalidArgument (values missing, too many or not finite), and those of the Projector.
  Result<Coefficients> project(const VertexPose& pose);

 private:
  /// n x s values of vertices as r x s coefficients, three columns a pass.
  Result<std::vector<double>> project_scalars(std::span<const float> values) const;

  std::shared_ptr<const Asset> asset_;
  bool velocities_;
  std::size_t scalars_;
  std::optional<Projector> projector_;
};

/// PublisherOptions::error, or its default for this surface.
double error_bound(const PublisherOptions& options, const Asset& asset);

StreamFormat format_of(const PublisherOptions& options, const Asset& asset);

/// Rows of x, y, z, scalars times their scale, and velocities in units of format.velocity_us.
///   C  r x 3;  V  r x 3, per second, or empty;  S  r x as many scalars as the format has
/// Empty where the sizes of C and V do not fit.
std::vector<double> rows_in_format(const StreamFormat& format, std::span<const double> C, std::span<const double> V,
                                   std::span<const double> S);

}  // namespace eigencast
