// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "view/camera.h"
#include "view/gl_objects.h"
#include "view/gl_surface.h"
#include "view/surroundings.h"

namespace eigencast {

/// Draws point clouds as discs whose shade goes over from one to the next. Needs its context current in every call.
class DiscPainter final {
 public:
  struct Target {
    const GlTarget& picture;
    glm::ivec2 size;
    float pixel_scale = 1;
    glm::vec2 colour_range{0, 1};
  };
  /// Errors: as GlProgram::build.
  Result<void> init();
  /// Within the scissor box; the target is bound afterwards.
  /// REQUIRES: the surface has discs; lighting.bind(); the colour table in unit 1.
  void draw(const GlSurface& surface, const Camera& camera, const Lighting& lighting, const Target& target);

 private:
  void resize(const glm::ivec2& size);
  void place(const GlProgram& program, const GlSurface& surface, const Camera& camera, const Target& target) const;

  GlProgram seen_, sum_;
  GlProgramFamily shade_;
  GlTexture depth_, outside_, facing_, base_;
  GlFramebuffer seen_framebuffer_, sum_framebuffer_;
  GlArray none_;
  glm::ivec2 size_{0};
};

}  // namespace eigencast
