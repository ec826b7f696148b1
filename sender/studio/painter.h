// SPDX-License-Identifier: MIT
#pragma once

#include <condition_variable>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "common/core/clock.h"
#include "common/core/histogram.h"
#include "common/core/log.h"
#include "view/glfw_window.h"
#include "view/markup.h"
#include "view/overlay.h"
#include "view/pose_source.h"
#include "view/renderer.h"
#include "view/scene.h"

namespace eigencast::studio {

struct Picturing {
  Camera camera;
  RenderOptions options;
  Markup markup;
  int width_px = 0, height_px = 0;
  std::shared_ptr<const SurfaceGeometry> surface;  ///< The user's own.
  std::uint64_t pose = 0;                          ///< Grows with each change of the surface.
  std::optional<TimeUs> input_us;                  ///< Time of the input that made this pose.
  std::vector<std::string> figures;                ///< The painter adds those of other streams; empty: none are shown.
  std::string connection;
  bool connected = false;
  std::vector<HelpLine> help;
};

struct PaintingReport {
  std::string device;
  std::uint64_t pictures = 0;
  Histogram input_to_drawn_us;     ///< From input to finished picture.
  std::uint64_t others_poses = 0;  ///< Poses of other streams that were shown.
};

/// Draws the newest state on a thread of its own, so that neither a slow GPU nor the display's rate delays what is
/// sent. All calls from one thread.
class Painter final {
 public:
  struct Options {
    GlfwWindow* window = nullptr;  ///< Its context must be current on no thread.
    float scale = 1;               ///< For text.
    glm::vec3 low{0}, high{0};     ///< Box of the user's surface at rest, with its handles.
    std::vector<std::unique_ptr<PoseSource>> others;
    std::vector<std::string> names;  ///< For the others.
    LogSink log;
  };
  /// Errors: those of Renderer::create.
  static Result<std::unique_ptr<Painter>> start(Options options);
  ~Painter();  ///< Ends the thread.

  void show(Picturing state);
  /// If it has changed since the last call.
  std::optional<std::pair<glm::vec3, glm::vec3>> take_box();
  PaintingReport report() const;

 private:
  explicit Painter(Options options);
  void run(std::promise<Result<void>>& ready);
  Result<void> open();
  bool wait();
  void turn();
  bool take_others();
  void place_others();
  void draw();
  std::vector<std::string> figures() const;

  // For the thread.
  Options options_;
  std::vector<PoseSource*> sources_;
  Scene scene_;
  glm::mat4 beside_{1};  ///< From the scene of the others.
  std::uint64_t box_version_ = 0, drawn_pose_ = 0;
  std::unique_ptr<Renderer> renderer_;
  std::unique_ptr<Overlay> overlay_;
  Picturing state_;
  bool has_news_ = false;
  std::thread thread_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_):
  bool stopping_ = false;
  std::optional<Picturing> wanted_;
  std::optional<std::pair<glm::vec3, glm::vec3>> box_;
  PaintingReport report_;
};

}  // namespace eigencast::studio
