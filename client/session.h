// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/connections.h"
#include "client/history.h"
#include "client/hud_text.h"
#include "client/level_control.h"
#include "client/options.h"
#include "client/pose_record.h"
#include "client/rate_meter.h"
#include "client/scene_colours.h"
#include "client/work_clock.h"
#include "view/camera.h"
#include "view/rebuilder_choice.h"
#include "view/renderer.h"
#include "view/scene.h"
#include "view/style.h"

namespace eigencast {

/// What window and headless viewer share: polls the sources, keeps the scene and its levels of detail, counts, records
/// poses, and writes the report.
///
/// Not thread-safe.
class Session final {
 public:
  /// The sources must outlive it. Errors: kIo (the record cannot be made).
  static Result<std::unique_ptr<Session>> create(const ClientOptions& options, std::span<PoseSource* const> sources,
                                                 LogSink log);

  /// Waits at most `timeout` for poses, then rebuilds the surfaces; true if there is something new to draw.
  bool update(std::chrono::milliseconds timeout, Camera& camera);
  /// Uploads and draws the scene; more may be drawn over it until finish_picture().
  void draw(Renderer& renderer, const Camera& camera, const Style& style, int width_px, int height_px, unsigned target);
  /// The picture is drawn, and yet to be shown: what it took ends here. Waits for the GPU if `wait` or if the
  /// levels of detail follow what a picture costs.
  void finish_picture(bool wait);
  /// Pixels of the picture to one at 96 dpi; at first as --ui-scale says.
  void set_pixel_scale(float scale) { pixel_scale_ = scale; }
  /// What the renderer is told for this style now.
  RenderOptions render_options(const Style& style) const;
  /// Of what draw() drew last; nothing while colours stand for no numbers.
  std::optional<Legend> legend() const;
  const SceneColours& colours() const { return colours_; }

  /// One source more, which must outlive the session or its removal; the surfaces that show it, all of them
  /// `placements`'.
  void add(PoseSource& source, const std::string& name, Placement placement = {});
  /// Takes a surface out, and its source if no other shows it: returned, to be ended by whoever owns it; else null.
  PoseSource* remove(std::size_t surface);
  const std::vector<PoseSource*>& sources() const { return connections_.sources(); }
  /// What people call a surface: its own name, or its stream's.
  std::string name_of_surface(std::size_t surface) const;
  /// How its stream stood when update() was called last.
  Subscriber::State state_of_surface(std::size_t surface) const;

  /// Who rebuilds the surfaces from now on; must outlive the session.
  void rebuild_with(const RebuilderChoice& choice);

  Scene& scene() { return scene_; }
  const Scene& scene() const { return scene_; }
  LevelControl& levels() { return levels_; }
  const LevelControl& levels() const { return levels_; }
  HudFigures figures() const;
  /// How the connections stand: a line, and what is to be said across the picture, if anything is.
  struct Standing {
    std::string line, banner;
  };
  Standing standing() const;
  /// The mean of all surfaces', of which each is 1 while poses may come and falls to 0 within half a second of a lost
  /// connection.
  float colourfulness() const;
  bool is_connected() const { return connections_.are_well(); }
  std::uint64_t drawn() const { return drawn_; }
  std::uint64_t written() const { return written_; }
  void count_written() { ++written_; }
  const History& history() const { return history_; }

  /// The report as JSON text (docs: client/README.md).
  std::string report(const Renderer& renderer, int width_px, int height_px) const;

 private:
  Session(const ClientOptions& options, std::span<PoseSource* const> sources, LogSink log);
  bool poll(std::chrono::milliseconds timeout);
  void remember(TimeUs now_us);
  void frame_scene(Camera& camera);
  std::optional<TimeUs> newest_arrival_us(std::size_t source) const;
  float colourfulness(const Scene::Instance& instance, TimeUs now_us) const;

  const ClientOptions options_;
  Connections connections_;
  LogSink log_;
  Scene scene_;
  std::optional<RebuilderChoice::Trial> rebuild_trial_;
  LevelControl levels_;
  SceneColours colours_;
  float pixel_scale_;
  History history_;
  TimeUs last_latency_us_ = 0;   ///< Capture to picture, of the newest pose drawn.
  bool renderer_stale_ = false;  ///< Surfaces have moved up: what the GPU holds belongs to others.
  PoseRecord record_;
  RateMeter keys_, poses_, drawn_rate_, bytes_;
  Histogram decode_us_, drawn_latency_us_, upload_us_, draw_us_, work_us_;
  TimeUs started_us_ = 0;
  /// What had been received when a pose arrived.
  struct Received {
    TimeUs arrival_us = 0;
    std::uint64_t keys = 0, bytes = 0, poses = 0;
  };
  std::optional<Received> first_, last_;
  TimeUs last_arrival_us_ = 0;
  WorkClock work_;
  TimeUs uploaded_us_ = 0;  ///< The surfaces of the picture that is being drawn.
  std::optional<FrameWork> last_work_;
  std::uint64_t poses_taken_ = 0, drawn_ = 0, written_ = 0;
  std::uint64_t facts_version_ = 0, drawn_pose_ = 0;
  bool up_set_ = false;
};

}  // namespace eigencast
