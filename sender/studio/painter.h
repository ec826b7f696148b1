// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/core/clock.h"
#include "common/core/histogram.h"
#include "common/core/log.h"
#include "view/glfw_window.h"
#include "view/markup.h"
#include "view/overlay.h"
#include "view/pose_source.h"
#include "view/renderer.h"
#include "view/surface_view.h"

namespace eigencast::studio {

/// One state of the window, to be drawn.
struct Picturing {
  Camera camera;
  RenderOptions options;
  Markup markup;
  int width_px = 0, height_px = 0;
  std::shared_ptr<const SurfaceGeometry> surface;  ///< One's own.
  std::uint64_t pose = 0;                          ///< Grows with what the hand does to it.
  std::optional<TimeUs> input_us;                  ///< When the hand moved that made this pose.
  std::vector<std::string> figures;                ///< The painter adds what it knows of others; empty: none are shown.
  std::string connection;
  bool connected = false;
  std::vector<HelpLine> help;
};

/// What drawing took, and what it found.
struct PaintingReport {
  std::string device;
  std::uint64_t pictures = 0;
  Histogram input_to_drawn_us;     ///< From the hand to a finished picture.
  std::uint64_t others_poses = 0;  ///< Poses of other streams that were shown.
};

/// Draws on a thread of its own, so that neither a slow GPU nor the display's rate delays what a hand sends.
/// Always the newest state; the streams of others between. All calls from one thread.
class Painter final {
 public:
  struct Options {
    GlfwWindow* window = nullptr;  ///< Its context must be current on no thread.
    float scale = 1;               ///< Of text.
    glm::vec3 low{0}, high{0};     ///< One's own surface at rest, with its handles.
    std::vector<std::unique_ptr<PoseSource>> others;
    std::vector<std::string> names;  ///< Of them.
    LogSink log;
  };
  /// Errors: those of Renderer::create.
  static Result<std::unique_ptr<Painter>> start(Options options);
  ~Painter();  ///< Ends the thread.

  void show(Picturing state);
  /// The box of everything that is drawn, in the scene, if it has changed since it was asked for last.
  std::optional<std::pair<glm::vec3, glm::vec3>> take_box();
  PaintingReport report() const;

 private:
  class Impl;
  explicit Painter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace eigencast::studio
