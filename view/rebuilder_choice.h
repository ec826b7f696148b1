// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>

#include "view/gpu_rebuilder.h"
#include "view/renderer.h"

namespace eigencast {

/// What was chosen, and what it was chosen by.
struct RebuilderChoice {
  /// What one pose of the trial surface took until it could be drawn, the fastest of several; of the GPU what an
  /// eighth of it took, where that alone was slower.
  struct Trial {
    TimeUs cpu_us = 0, gpu_us = 0;
    bool gpu_is_faster() const { return gpu_us < cpu_us; }
  };

  std::unique_ptr<GpuRebuilder> gpu;  ///< Null: the processor rebuilds.
  std::optional<Trial> trial;         ///< Where it was measured.
};

/// Makes what was asked for; kAuto measures both on a surface of 16,384 vertices and 96 coefficients, which takes a few
/// tens of milliseconds, and takes the processor where the GPU cannot do it. `renderer` forgets its surfaces. finish:
/// see GpuRebuilder.
/// Errors, if the GPU was asked for: as GpuRebuilder::create.
Result<RebuilderChoice> choose_rebuilder(RebuildOn on, Renderer& renderer, bool finish);

}  // namespace eigencast
