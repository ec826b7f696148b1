// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/surface.h"

namespace eigencast::deform {

/// X = W y: vertices (n x 3) from controls (c x 3).
struct LinearMap {
  std::size_t vertices = 0;  ///< n
  std::size_t controls = 0;  ///< c
  std::vector<double> W;     ///< n x c, row-major
};

/// A surface that follows handles. Not thread-safe: some remember their last pose.
class Deformer {
 public:
  virtual ~Deformer() = default;
  /// The handles at rest.
  virtual std::span<const Vec3> handles() const = 0;
  /// They join the handles in pictures; may be empty.
  virtual std::span<const Face> handle_faces() const = 0;
  /// n x 3. REQUIRES: moved.size() == handles().size().
  virtual std::vector<Vec3> positions(std::span<const Vec3> moved) = 0;
  /// The map that positions() is, if it is linear in controls; else null.
  virtual const LinearMap* linear_map() const { return nullptr; }
  /// Whether it works on an asset's basis itself; else its positions are projected.
  virtual bool makes_coefficients() const { return false; }
  /// r x 3, row-major. REQUIRES: makes_coefficients(); as positions().
  virtual std::vector<double> coefficients(std::span<const Vec3>) { return {}; }
  /// y (c x 3, row-major). REQUIRES: linear_map() is not null; as positions().
  virtual std::vector<double> controls(std::span<const Vec3>) const { return {}; }
};

std::vector<Vec3> applied(const LinearMap& map, std::span<const double> y);

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
