// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>

#include "view/rebuild.h"
#include "view/renderer.h"

namespace eigencast {

struct RebuilderChoice {
  /// Time from coefficients to a drawable pose of the trial surface, the fastest of several; gpu_us is that of an
  /// eighth of the surface where that alone was slower.
  struct Trial {
    TimeUs cpu_us = 0, gpu_us = 0;
    bool gpu_is_faster() const { return gpu_us < cpu_us; }
  };

  std::unique_ptr<SurfaceRebuilder> gpu;  ///< Null: the processor rebuilds.
  std::optional<Trial> trial;             ///< Where it was measured.
};

/// kAuto measures both on a surface of 16,384 vertices and 96 coefficients, which takes a few tens of milliseconds, and
/// falls back to the processor. `renderer` forgets its surfaces. finish: see make_gpu_rebuilder().
/// Errors of kGpu: as make_gpu_rebuilder().
Result<RebuilderChoice> choose_rebuilder(RebuildOn on, Renderer& renderer, bool finish);

}  // namespace eigencast
