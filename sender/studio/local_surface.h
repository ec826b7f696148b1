// SPDX-License-Identifier: MIT
#pragma once

#include <glm/vec3.hpp>
#include <utility>

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "sender/deform/deformer.h"
#include "view/surface_view.h"

namespace eigencast::studio {

/// The surface as its maker sees it: deformed in full detail, and as the coefficients give it to those who watch; and
/// how far these are apart. In the asset's order and space. Not thread-safe.
class LocalSurface {
 public:
  /// map: of the deformer, or null: what is sent is all that there is. Keeps its weights as floats, n x c, and a
  /// reference to the asset. The map must carry a shift of all handles to all vertices, as coordinates of cages do.
  LocalSurface(const Asset& asset, const deform::LinearMap* map);

  /// y: controls of the linear map (c x 3), of handles in the asset's space; C: r x 3. Takes one pass over each basis.
  void set(std::span<const double> y, std::span<const double> C);
  /// Which of the two geometry() is; from the next set() on.
  void show_received(bool received) { received_shown_ = received; }
  bool received_shown() const { return received_shown_ || full_.tiles().rank() == 0; }

  /// Of the rest pose, in the asset's space.
  std::pair<glm::vec3, glm::vec3> box() const;
  const SurfaceGeometry& geometry() const { return geometry_; }
  double rms() const { return rms_; }  ///< Of the vertex distances, over the diagonal of the rest box.
  double max() const { return max_; }  ///< The largest, likewise.

 private:
  void compare();

  const Asset* asset_;
  Reconstructor full_, received_;
  std::vector<float> full_positions_, received_positions_;
  SurfaceGeometry geometry_;
  bool received_shown_ = false;
  double rms_ = 0, max_ = 0;
};

}  // namespace eigencast::studio
