// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast::deform {

/// X = W y: the vertices of a surface (n x 3) as a fixed linear map of controls (c x 3).
struct LinearMap {
  std::size_t vertices = 0;  ///< n
  std::size_t controls = 0;  ///< c
  std::vector<double> W;     ///< n x c, row-major
};

/// Deforms a surface by handles: points that a hand, a script or another program moves. What a window shows and drags
/// are handles() and handle_faces(); what it need not know is how the surface follows.
///
/// Not thread-safe: some remember their last pose.
class Deformer {
 public:
  virtual ~Deformer() = default;
  /// The handles at rest.
  virtual std::span<const Vec3> handles() const = 0;
  /// Triangles between handles, to draw them by; may be empty.
  virtual std::span<const Face> handle_faces() const = 0;
  /// The surface (n x 3) when the handles are at `moved`. REQUIRES: moved.size() == handles().size().
  virtual std::vector<Vec3> positions(std::span<const Vec3> moved) = 0;
  /// The map that positions() is, if it is linear in controls that the handles determine; else null.
  virtual const LinearMap* linear_map() const { return nullptr; }
  /// Whether it works on an asset's basis itself and gives its coefficients; else they are projected.
  virtual bool makes_coefficients() const { return false; }
  /// Those of the pose (r x 3, row-major). REQUIRES: makes_coefficients(); as positions().
  virtual std::vector<double> coefficients(std::span<const Vec3>) { return {}; }
  /// The controls y (c x 3, row-major) of the linear map. REQUIRES: linear_map() is not null; as positions().
  virtual std::vector<double> controls(std::span<const Vec3>) const { return {}; }
};

/// W y as points.
std::vector<Vec3> applied(const LinearMap& map, std::span<const double> y);

}  // namespace eigencast::deform
