// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/result.h"
#include "view/rebuild.h"

namespace eigencast {

/// Rebuilds on the GPU, with OpenGL 3.3 core: the basis lies there, a pose is its coefficients (12 bytes
/// each), and positions and normals never leave it. Results are those of CpuRebuilder but for rounding: positions
/// within 2e-6 of the sum of their terms' magnitudes (on the way between levels: or of the largest such sum of those
/// that the vertex comes from), and what CpuRebuilder moves them by where it rounds coefficients to 16 bits
/// (BasisTiles::whole_coefficients), which the GPU does not; normals where the surface has any area within 0.1
/// degrees.
///
/// A surface too large for the GPU's buffers, or with detail (DetailKind), is rebuilt on the processor, as its
/// geometry then says (no `gpu`).
///
/// Belongs to the OpenGL context that was current when it was made, which must be current in every call and when it and
/// the surfaces that it has rebuilt go. Not thread-safe.
class GpuRebuilder final : public SurfaceRebuilder {
 public:
  /// finish: waits for the GPU after each part, so that the costs are those of the parts and not of asking for them.
  /// Errors: kUnsupported (OpenGL below 3.3), kInternal (a shader does not compile; the message holds the log).
  static Result<std::unique_ptr<GpuRebuilder>> create(bool finish = false);
  ~GpuRebuilder() override;

  Cost rebuild(std::span<const RebuildJob> jobs) override;
  std::string_view name() const override { return "gpu"; }
  /// The GPU can address the asset, and its basis is all that there is to it.
  bool fits(const Asset& asset) const;

 private:
  class Impl;
  explicit GpuRebuilder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Positions and normals of a surface that the GPU has rebuilt, read back: for tests and measurements. Empty normals
/// where it has none. REQUIRES: geometry.gpu.
struct ReadBack {
  std::vector<float> positions, normals;
};
ReadBack read_back(const SurfaceGeometry& geometry);

}  // namespace eigencast
