// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/camera_path.h"
#include "client/open_source.h"
#include "client/session.h"
#include "client/settings.h"
#include "client/ui/panel.h"
#include "client/viewer_state.h"
#include "view/glfw_window.h"
#include "view/overlay.h"
#include "view/renderer.h"

namespace eigencast {

/// Draws only when something has changed. On the main thread.
class Viewer final : public WindowListener {
 public:
  Viewer(const ClientOptions& options, OpenSource open, LogSink log);
  ~Viewer() override;

  /// The sources must outlive the viewer. Errors: kUnsupported (no window); as CameraPath::read, Session::create.
  Result<void> open(std::span<PoseSource* const> sources);
  bool closed() const { return window_.close_wanted() || state_.quit; }
  /// One turn: input, poses, a picture if either changed it, then files that the user wants.
  void turn();
  /// With its texts. Errors: kIo.
  Result<void> save(const std::string& path);
  const Session& session() const { return *session_; }
  std::string report() const { return session_->report(*renderer_, width_, height_); }
  Result<void> remember();

 private:
  void on_resize(int width_px, int height_px) override;
  void on_event() override { redraw_ = kRedrawsAfterInput; }
  void on_key(const std::string& name, const Modifiers& modifiers, bool repeated) override;
  void on_drag(Drag drag, glm::vec2 by_px) override;
  void on_wheel(float steps, glm::vec2 at_px) override;
  void on_double_click(glm::vec2 at_px) override;
  void on_drop(const std::vector<std::string>& what) override;

  static constexpr int kRedrawsAfterInput = 4;  ///< Panels react to input some pictures later.

  void open_wanted(const std::string& text);
  Result<void> add_stream(const std::string& stream, const Placement& placement);
  Result<void> add_scene(const std::string& path);
  void remove(std::size_t surface);
  void say(const std::string& notice, bool bad);
  bool move_camera(TimeUs now_us);
  void do_what_keys_wanted();
  void paste(const std::string& text);
  bool content_changed(TimeUs now_us);
  OverlayContent overlay_content() const;
  Style window_style() const;
  TextScale text_scale_now() const;
  void draw();
  void draw_panels();
  void write_what_is_wanted(bool scene_changed);
  Result<void> save_scene(const std::string& path, bool transparent);

  const ClientOptions options_;
  const OpenSource open_;
  const LogSink log_;
  GlfwWindow window_{"--headless --frames 90 --out DIR writes pictures instead"};
  // Renderer, rebuilder and overlay need the window's context for destruction.
  std::unique_ptr<Renderer> renderer_;
  RebuilderChoice rebuilder_;
  std::unique_ptr<Overlay> overlay_;
  struct Opened {
    std::string stream;
    std::unique_ptr<PoseSource> source;
  };
  std::vector<Opened> opened_;  ///< By the user.
  std::unique_ptr<Session> session_;
  Camera camera_;
  ViewerState state_;
  Settings settings_;
  TextField to_open_{};
  UiRequests requests_;
  std::optional<CameraPath> path_;
  std::optional<TimeUs> flight_began_us_;
  TimeUs turned_us_ = 0, checked_us_ = 0;
  std::string notice_;
  TimeUs notice_until_us_ = 0;
  std::string record_folder_;
  std::uint64_t recorded_ = 0;
  OverlayContent drawn_content_;
  float drawn_colourfulness_ = 1;
  int redraw_ = kRedrawsAfterInput;
  int width_ = 0, height_ = 0;
};

}  // namespace eigencast
