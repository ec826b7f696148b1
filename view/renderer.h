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
#include "view/rebuild.h"
#include "view/style.h"

namespace eigencast {

struct RenderOptions : DrawStyle {
  float pixel_scale = 1;                    ///< Pixels to one at 96 dpi: the width of lines and the smallest points.
  std::array<float, 2> colour_range{0, 1};  ///< The values at the ends of the colour map.
  PictureQuality quality;
};

/// Windows and headless rendering give the same picture. The OpenGL context of its creation must be current in every
/// call. Not thread-safe.
class Renderer final {
 public:
  /// Errors: kUnsupported (OpenGL below 3.3), kInternal (a shader does not compile).
  static Result<std::unique_ptr<Renderer>> create();
  ~Renderer();

  /// Default: 1. Forgets surfaces beyond the count; new ones are empty.
  void set_surface_count(std::size_t count);
  /// REQUIRES: surface < the count.
  void upload(std::size_t surface, const SurfaceGeometry& geometry);
  /// REQUIRES: values match the uploaded geometry.
  void paint(std::size_t surface, const SurfacePaint& paint);
  /// colourfulness: 0 is grey, as of a lost connection.
  void place(std::size_t surface, const glm::mat4& scene_from_surface, bool visible = true, float colourfulness = 1);
  void mark(Markup markup);
  void draw(const Camera& camera, const RenderOptions& options, int width_px, int height_px, unsigned target = 0);
  /// Errors: kUnsupported (larger than the GPU can draw).
  Result<Picture> picture(const Camera& camera, const RenderOptions& options, int width_px, int height_px);
  static Picture read_back(int width_px, int height_px, unsigned source = 0, bool with_alpha = false);

  /// An off-screen framebuffer, kept until another size is asked for; a second one if `other`.
  unsigned offscreen_target(int width_px, int height_px, bool other = false);

  static void copy_to_window(unsigned source, int width_px, int height_px);

  static int max_texture_side();      ///< That the GPU takes.
  int samples() const;                ///< Per pixel of the last picture, as the driver gave them.
  const std::string& device() const;  ///< The driver's name for itself.
  static void finish();               ///< Waits until everything has been drawn.

 private:
  class Impl;
  explicit Renderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// An OpenGL 3.3 core context without window and display server (EGL surfaceless), current on the thread that creates
/// and destroys it.
class OffscreenContext final {
 public:
  /// Errors: kUnsupported, naming the missing driver package.
  static Result<std::unique_ptr<OffscreenContext>> create();
  ~OffscreenContext();

 private:
  OffscreenContext() = default;
  void* display_ = nullptr;
  void* context_ = nullptr;
};

}  // namespace eigencast
