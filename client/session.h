// SPDX-License-Identifier: MIT
#pragma once

#include <fstream>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "client/camera.h"
#include "client/hud_text.h"
#include "client/options.h"
#include "client/rate_meter.h"
#include "client/renderer.h"
#include "client/scene_state.h"

namespace eigencast {

/// What window and headless viewer share: polls the source, keeps the scene, counts, says on the log how the connection
/// stands, records poses, and writes the report.
///
/// Not thread-safe.
class Session final {
 public:
  /// The source must outlive it. Errors: kIo (the record cannot be made).
  static Result<std::unique_ptr<Session>> create(const ClientOptions& options, PoseSource& source, LogSink log);

  /// Waits at most `timeout` for poses, then rebuilds the surface; true if there is something new to draw.
  bool update(std::chrono::milliseconds timeout, Camera& camera);
  /// Uploads and draws the scene; measures both. Waits for the graphics card only if `finish`.
  void draw(Renderer& renderer, const Camera& camera, RenderOptions options, int width_px, int height_px,
            unsigned target, bool finish);

  SceneState& scene() { return scene_; }
  const SceneState& scene() const { return scene_; }
  Subscriber::Stats stats() const { return source_.stats(); }
  HudFigures figures() const;
  std::string connection() const;
  std::string banner() const;
  /// 1 while poses may come, falling to 0 within half a second of a lost connection.
  float colourfulness() const;
  bool is_connected() const;
  std::uint64_t drawn() const { return drawn_; }
  std::uint64_t written() const { return written_; }
  void count_written() { ++written_; }

  /// The report as JSON text (docs: client/README.md).
  std::string report(const Renderer& renderer, int width_px, int height_px) const;

 private:
  Session(const ClientOptions& options, PoseSource& source, LogSink log);
  void record(const std::vector<ReceivedPose>& poses);
  void record_shown(TimeUs drawn_us);
  void note_arrivals(const std::vector<ReceivedPose>& poses);
  void say_state();
  void frame_scene(Camera& camera);

  const ClientOptions options_;
  PoseSource& source_;
  LogSink log_;
  SceneState scene_;
  std::ofstream record_, shown_record_;
  RateMeter keys_, poses_, drawn_rate_, bytes_;
  Histogram drawn_latency_us_, upload_us_, draw_us_;
  TimeUs started_us_ = 0;
  /// What had been received when a pose arrived.
  struct Received {
    TimeUs arrival_us = 0;
    std::uint64_t keys = 0, bytes = 0, poses = 0;
  };
  std::optional<Received> first_, last_;
  TimeUs last_arrival_us_ = 0;
  std::optional<TimeUs> lost_since_us_;
  std::uint64_t poses_taken_ = 0, drawn_ = 0, written_ = 0;
  std::uint64_t facts_version_ = 0, drawn_pose_ = 0;
  std::optional<Subscriber::State> said_;
  bool up_set_ = false;
};

}  // namespace eigencast
