// SPDX-License-Identifier: MIT
#pragma once

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "sender/deform/deformer.h"
#include "view/surface_view.h"

namespace eigencast::studio {

/// The user's surface in full detail and as viewers get it, and the error between both. In the asset's order and space.
/// Not thread-safe.
class LocalSurface {
 public:
  /// map: null: there is only the sent surface. It must carry a shift of all handles to all vertices, as coordinates of
  /// cages do. Refers to the asset.
  LocalSurface(const Asset& asset, const deform::LinearMap* map);

  /// y: controls of the linear map (c x 3), of handles in the asset's space; C: r x 3.
  void set(std::span<const double> y, std::span<const double> C);
  /// Takes effect from the next set() on.
  void show_received(bool received) { received_shown_ = received; }
  bool received_shown() const { return received_shown_ || full_.tiles().rank() == 0; }
  const SurfaceGeometry& geometry() const { return geometry_; }
  double rms() const { return rms_; }  ///< Vertex distances over the diagonal of the rest box.
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
