// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <glm/mat4x4.hpp>
#include <memory>
#include <string>

#include "common/core/result.h"
#include "view/camera.h"
#include "view/markup.h"
#include "view/picture.h"
#include "view/style.h"
#include "view/surface_geometry.h"

namespace eigencast {

struct RenderOptions : DrawStyle {
  float pixel_scale = 1;                    ///< Pixels to one at 96 dpi: the width of lines and the smallest points.
  std::array<float, 2> colour_range{0, 1};  ///< The values at the ends of the colour map.
};

/// Draws surfaces with OpenGL 3.3 core, 4 samples a pixel, into a framebuffer of its own and from there to wherever is
/// bound: the window and headless rendering give the same picture.
///
/// Belongs to the OpenGL context that was current when it was made, which must be current in every call. Not
/// thread-safe.
class Renderer final {
 public:
  /// Errors: kUnsupported (OpenGL below 3.3), kInternal (a shader does not compile; the message holds the log).
  static Result<std::unique_ptr<Renderer>> create();
  ~Renderer();

  /// There are so many surfaces from now on: those beyond are forgotten, new ones are empty and in their own place.
  void set_surface_count(std::size_t count);
  /// Hands the changed parts of a surface to the GPU. REQUIRES: surface < the count, which is 1 at first.
  void upload(std::size_t surface, const SurfaceGeometry& geometry);
  /// What its vertices are painted with. REQUIRES: as many values as the uploaded geometry's vertices take.
  void paint(std::size_t surface, const SurfacePaint& paint);
  /// Where a surface stands, whether it is drawn, and how much of its colours is left: 0 = grey, as while its
  /// connection is lost.
  void place(std::size_t surface, const glm::mat4& scene_from_surface, bool visible = true, float colourfulness = 1);
  /// What to draw over the surfaces from now on.
  void mark(Markup markup);
  /// Draws what was uploaded last (nothing is fine) to framebuffer `target` (0 = the window), width x height pixels.
  void draw(const Camera& camera, const RenderOptions& options, int width_px, int height_px, unsigned target = 0);
  /// Draws into memory. Errors: kUnsupported (larger than the GPU can).
  Result<Picture> picture(const Camera& camera, const RenderOptions& options, int width_px, int height_px);
  /// What is in framebuffer `source` now. with_alpha: its alpha, too, where it has one.
  static Picture read_back(int width_px, int height_px, unsigned source = 0, bool with_alpha = false);

  /// An off-screen framebuffer of this size that may be drawn to and read back; kept until another size is asked for.
  unsigned offscreen_target(int width_px, int height_px);

  /// Shows what is in framebuffer `source` in the window, as soon as that is swapped.
  static void copy_to_window(unsigned source, int width_px, int height_px);

  static int max_texture_side();      ///< That the GPU takes.
  int samples() const;                ///< Per pixel, as the driver gave them.
  const std::string& device() const;  ///< The driver's name for itself.
  static void finish();               ///< Waits until everything has been drawn; for measuring.

 private:
  class Impl;
  explicit Renderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace eigencast
