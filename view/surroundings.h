// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <span>

#include "common/core/result.h"
#include "view/camera.h"
#include "view/gl_objects.h"

namespace eigencast {

class GlSurface;

/// Two lights that follow the camera, and the shadow of the first. Needs its context current in every call.
class Lighting final {
 public:
  /// Errors: as GlProgram::build.
  Result<void> init();
  /// Places the lights beside the camera and renders the shadow map, whose framebuffer stays bound.
  void cast(const Camera& camera, std::span<const std::unique_ptr<GlSurface>> surfaces);
  void bind() const { bind_texture(0, GL_TEXTURE_2D, shadows_.id()); }
  /// Uses a program of shaders::kLighting.
  void light(const GlProgram& program, const Camera& camera) const;

 private:
  GlProgram shadow_;
  GlTexture shadows_;
  GlFramebuffer framebuffer_;
  glm::vec3 key_{0, 1, 0}, fill_{0, 0, 1};
  glm::mat4 light_from_scene_{1};
};

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
