// SPDX-License-Identifier: MIT
#pragma once

#include <fstream>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/connections.h"
#include "client/hud_text.h"
#include "client/level_control.h"
#include "client/meters.h"
#include "client/options.h"
#include "client/rewind_desk.h"
#include "client/room_desk.h"
#include "client/scene_colours.h"
#include "view/camera.h"
#include "view/overlay.h"
#include "view/rebuild.h"
#include "view/renderer.h"
#include "view/scene.h"
#include "view/style.h"

namespace eigencast {

/// When what is shown was captured; nothing: it is of an epoch before.
std::optional<TimeUs> utc_shown(const SurfaceView& view, const PoseSource& source);

/// Writes received and shown poses, one JSON object a line (client/README.md has the fields). Not thread-safe.
class PoseRecord final {
 public:
  /// Paths may be empty. Errors: kIo.
  Result<void> open(const std::string& received, const std::string& shown);

  void received(std::size_t source, std::span<const ReceivedPose> poses);
  void shown(const Scene& scene, std::span<PoseSource* const> sources, TimeUs drawn_us);

 private:
  std::ofstream received_, shown_;
};

/// What window and headless viewer share: polls the sources, keeps scene and levels of detail, counts, records poses,
/// and writes the report. Not thread-safe.
class Session final {
 public:
  /// The sources must outlive it. Errors: kIo (the record cannot be made).
  static Result<std::unique_ptr<Session>> create(const ClientOptions& options, std::span<PoseSource* const> sources,
                                                 LogSink log);

  /// Waits at most `timeout` for poses, then rebuilds the surfaces; true if any has changed. film_us: the moment to
  /// show, instead of the present one.
  bool update(std::chrono::milliseconds timeout, Camera& camera, std::optional<TimeUs> film_us = {});
  /// Takes the colours of what is shown now, which their range then covers, without a picture.
  void take_colours(const Style& style) { colours_.update(scene_, sources(), style); }
  /// Uploads and draws the scene. Overlays follow before finish_picture().
  void draw(Renderer& renderer, const Camera& camera, const Style& style, int width_px, int height_px, unsigned target);
  /// Ends the measurement of the picture's work. Waits for the GPU if `wait` or if a resolver needs the measurement.
  void finish_picture(bool wait);
  void set_pixel_scale(float scale) { pixel_scale_ = scale; }
  /// At full quality, as of screenshots.
  RenderOptions render_options(const Style& style) const { return {style, pixel_scale_, colours_.range(style), {}}; }
  const SceneColours& colours() const { return colours_; }

  /// Adds a surface of a source, which may be new and must outlive the session or its removal.
  void add(PoseSource& source, const std::string& name, Placement placement = {});
  /// Removes a surface. Returns its source if no other surface shows it, for the owner to destroy; else null.
  PoseSource* remove(std::size_t surface);
  const std::vector<PoseSource*>& sources() const { return connections_.sources(); }
  std::string name_of_surface(std::size_t surface) const;
  Subscriber::State state_of_surface(std::size_t surface) const {
    return connections_.stats(scene_.instances()[surface].placement.source).state;
  }

  /// The rebuilder must outlive the session.
  void rebuild_with(const RebuilderChoice& choice);

  Scene& scene() { return scene_; }
  const Scene& scene() const { return scene_; }
  /// Null: it is in none.
  RoomDesk* room() { return room_.get(); }
  const RoomDesk* room() const { return room_.get(); }
  RewindDesk& rewind() { return rewind_; }
  const RewindDesk& rewind() const { return rewind_; }
  /// Pointers and pins of its room.
  std::vector<Label> labels(const Camera& camera) const;
  LevelControl& levels() { return levels_; }
  const LevelControl& levels() const { return levels_; }
  HudFigures figures() const;
  OverlayContent overlay_content() const;
  struct Status {
    std::string line, banner;
  };
  Status status() const;
  /// The mean of all surfaces; falls from 1 to 0 within half a second of a lost connection.
  float colourfulness() const;
  bool is_fading() const;  ///< Any surface, to grey.
  void count_written() { ++written_; }
  const History& history() const { return history_; }

  /// JSON (client/README.md).
  std::string report(const Renderer& renderer, int width_px, int height_px) const;

 private:
  Session(const ClientOptions& options, std::span<PoseSource* const> sources, LogSink log);
  bool poll(std::chrono::milliseconds timeout);
  void remember(TimeUs now_us);
  bool look_still(const Camera& camera, TimeUs now_us);
  void try_quality(Renderer& renderer, const Camera& camera, RenderOptions options, const PictureQuality& other,
                   int width_px, int height_px, unsigned target);
  double drawn_part() const;  ///< Of all vertices.
  void frame_scene(Camera& camera);
  std::optional<TimeUs> shown_utc_us() const;  ///< Of the first surface.
  std::optional<TimeUs> newest_arrival_us(std::size_t source) const;
  float colourfulness(const Scene::Instance& instance, TimeUs now_us) const;

  const ClientOptions options_;
  Connections connections_;
  LogSink log_;
  Scene scene_;
  std::optional<RebuilderChoice::Trial> rebuild_trial_;
  LevelControl levels_;
  SceneColours colours_;
  RewindDesk rewind_;
  std::unique_ptr<RoomDesk> room_;
  std::string room_trouble_;  ///< As logged.
  float pixel_scale_;
  History history_;
  TimeUs last_latency_us_ = 0;   ///< From capture to picture.
  bool renderer_stale_ = false;  ///< Surfaces have moved up: the GPU's buffers belong to others.
  PoseRecord record_;
  RateMeter keys_, poses_, drawn_rate_, bytes_, frames_, recalled_;
  Histogram decode_us_, seek_us_, drawn_latency_us_, upload_us_, draw_us_, work_us_;
  Histogram used_permille_{11}, drawn_permille_{11};  ///< Of pictures in which something was lowered: time, vertices.
  TimeUs started_us_ = 0;
  struct Received {
    TimeUs arrival_us = 0;
    std::uint64_t keys = 0, frames = 0, bytes = 0, poses = 0;
  };
  std::optional<Received> first_, last_;
  TimeUs last_arrival_us_ = 0;
  WorkClock work_;
  TimeUs uploaded_us_ = 0;  ///< For the present picture.
  std::optional<FrameWork> last_work_;
  std::uint64_t poses_taken_ = 0, drawn_ = 0, written_ = 0;
  struct Seen {
    std::uint64_t pose = 0;
    glm::vec3 eye{0}, target{0};
    bool operator==(const Seen&) const = default;
  } seen_;  ///< What the picture shows.
  Stillness stillness_;
  std::uint64_t facts_version_ = 0, drawn_pose_ = 0;
  bool up_set_ = false;
};

}  // namespace eigencast
