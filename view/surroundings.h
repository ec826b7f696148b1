// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>

#include "common/core/result.h"
#include "view/camera.h"
#include "view/gl_objects.h"
#include "view/style.h"

namespace eigencast {

class GlSurface;

/// Two lights that follow the camera, and the shadow of the first. Needs its context current in every call.
class Lighting final {
 public:
  /// Errors: as GlProgram::build.
  Result<void> init();
  /// Places the lights beside the camera and renders the shadow map, whose framebuffer stays bound.
  void cast(const Camera& camera, std::span<const std::unique_ptr<GlSurface>> surfaces, ShadowQuality quality);
  /// Where the shadow falls on a floor at that height, as far as is known.
  PixelBox shadow_on(const Camera& camera, float level, int width_px, int height_px) const;
  ShadowQuality quality() const { return quality_; }  ///< As cast.
  void bind() const {
    bind_texture(kRangeUnit, GL_TEXTURE_2D, range_.id());
    bind_texture(0, GL_TEXTURE_2D, shadows_.id());
  }
  /// Uses a program of shaders::kLighting.
  void light(const GlProgram& program, const Camera& camera) const;

 private:
  static constexpr GLuint kRangeUnit = 5;  // lower ones: shadow map, colour table, images
  void find_range();

  GlProgram shadow_, disc_shadow_, range_of_;
  GlTexture shadows_, range_;
  GlFramebuffer framebuffer_, range_framebuffer_;
  GlArray none_;
  int side_ = 0;                   ///< Of the shadow map.
  std::optional<Bounds> casters_;  ///< What casts the shadow lies within; nothing if only the GPU knows.
  ShadowQuality quality_ = ShadowQuality::kFull;
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
    int width_px = 0, height_px = 0;
  };
  /// REQUIRES: lighting.bind().
  void draw_floor(const Camera& camera, const Lighting& lighting, const Floor& floor);
  void draw_axes(const Camera& camera, float pixel_scale) const;

 private:
  void use_floor(const Camera& camera, const Lighting& lighting, const Floor& floor, float level, ShadowQuality shadow);
  GlProgram wall_, line_;
  GlProgramFamily floor_;
  GlArray none_, axes_;
  GlBuffer ends_;
};

}  // namespace eigencast
