// SPDX-License-Identifier: MIT
#pragma once

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "sender/deform/deformer.h"

namespace eigencast::deform {

/// Where the deformer is linear, X = W y, its weights are projected once: C = (L W) y - (L 1) origin^T with the
/// projector's L, so that a pose costs an r x c product. Else it makes coefficients itself, or each pose is projected.
/// Keeps references to all three. Not thread-safe.
class ProjectedDeformer {
 public:
  /// Errors: kInvalidArgument (another number of vertices than the asset's), those of the projector.
  static Result<ProjectedDeformer> create(Deformer& deformer, const Asset& asset, const Projector& projector);

  /// r x 3, row-major. REQUIRES: moved.size() == handles. Errors: kInvalidArgument: a pose that is not finite.
  Result<std::vector<double>> coefficients(std::span<const Vec3> moved);

 private:
  ProjectedDeformer(Deformer& deformer, const Projector& projector) : deformer_(&deformer), projector_(&projector) {}
  Result<void> project_weights(const LinearMap& map, const Asset& asset);

  Deformer* deformer_;
  const Projector* projector_;
  std::size_t rank_ = 0, controls_ = 0;
  std::vector<double> P_;       ///< r x c, row-major: L W.
  std::vector<double> offset_;  ///< r x 3: (L 1) origin^T.
};

}  // namespace eigencast::deform
