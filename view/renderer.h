// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <memory>
#include <string>

#include "common/core/result.h"
#include "view/camera.h"
#include "view/picture.h"
#include "view/surface_view.h"

namespace eigencast {

struct RenderOptions {
  bool edges = false, points = false, axes = false, grid = true;
  float colourfulness = 1;  ///< 0 = grey, as while the connection is lost.
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
  /// Hands the changed parts of a surface to the graphics card. REQUIRES: surface < the count, which is 1 at first.
  void upload(std::size_t surface, const SurfaceGeometry& geometry);
  /// Where a surface stands, and whether it is drawn.
  void place(std::size_t surface, const glm::mat4& scene_from_surface, bool visible = true);
  /// Draws what was uploaded last (nothing is fine) to framebuffer `target` (0 = the window), width x height pixels.
  void draw(const Camera& camera, const RenderOptions& options, int width_px, int height_px, unsigned target = 0);
  /// Draws into memory. Errors: kUnsupported (larger than the card can).
  Result<Picture> picture(const Camera& camera, const RenderOptions& options, int width_px, int height_px);
  /// What is in framebuffer `source` now.
  static Picture read_back(int width_px, int height_px, unsigned source = 0);

  /// An off-screen framebuffer of this size that may be drawn to and read back; kept until another size is asked for.
  unsigned offscreen_target(int width_px, int height_px);

  int samples() const;                ///< Per pixel, as the driver gave them.
  const std::string& device() const;  ///< The driver's name for itself.
  static void finish();               ///< Waits until everything has been drawn; for measuring.

 private:
  class Surface;
  class Impl;
  explicit Renderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace eigencast
