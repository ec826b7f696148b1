// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "view/camera.h"
#include "view/gl_objects.h"
#include "view/lighting.h"

namespace eigencast {

/// The wall, the floor with the surfaces' shadows, and the scene's axes. Needs its context current in every call.
class Surroundings final {
 public:
  /// Errors: as GlProgram::build.
  Result<void> init();
  void draw_wall() const;
  struct Floor {
    bool grid = true;
    bool shadow = true;     ///< Where surfaces touch it.
    float pixel_scale = 1;  ///< Width of the grid's lines.
  };
  /// REQUIRES: lighting.bind().
  void draw_floor(const Camera& camera, const Lighting& lighting, const Floor& floor) const;
  void draw_axes(const Camera& camera, float pixel_scale) const;

 private:
  GlProgram wall_, floor_, line_;
  GlArray none_, axes_;
  GlBuffer ends_;
};

}  // namespace eigencast
