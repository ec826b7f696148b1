// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "view/gl_objects.h"

namespace eigencast {

/// Lines and dots over surfaces: handles to grab. Widths are pixels; fainter where a surface is in front. Colours are
/// sRGB with opacity.
struct Markup {
  struct Line {
    glm::vec3 from{0}, to{0};  ///< In the scene.
    glm::vec4 colour{1};
    float width_px = 1.5F;
    bool on_top = false;  ///< Never hidden.
  };
  struct Dot {
    glm::vec3 at{0};
    glm::vec4 colour{1};
    float diameter_px = 8;
    bool on_top = false;
  };
  std::vector<Line> lines;
  std::vector<Dot> dots;
  std::optional<std::pair<glm::vec2, glm::vec2>> frame;  ///< Corners of a rectangle on the picture, pixels.
};

/// A corner of a triangle on the screen. A fragment with |round| > 1 is not drawn.
struct MarkCorner {
  glm::vec4 clip{0, 0, 0, 1};
  glm::vec4 colour{1};
  glm::vec2 round{0};
};

/// The marks as triangles; those that are never hidden come last, from corner `top` on. Lines end at the near plane.
struct MarkTriangles {
  std::vector<MarkCorner> corners;
  std::size_t top = 0;
};
MarkTriangles triangles_from_markup(const Markup& markup, const glm::mat4& clip_from_scene, int width_px,
                                    int height_px);

/// Keeps the bound framebuffer's depth. Belongs to one OpenGL context.
class MarkupPainter final {
 public:
  Result<void> init();
  void draw(const Markup& markup, const glm::mat4& clip_from_scene, int width_px, int height_px) const;

 private:
  GlProgram program_;
  GlArray array_;
  GlBuffer corners_;
};

}  // namespace eigencast
