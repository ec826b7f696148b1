// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>

#include "client/session.h"
#include "view/overlay.h"
#include "view/renderer.h"

namespace eigencast {

/// What pictures without a window are drawn with, of the options' size. Not thread-safe.
class OffscreenViewer final {
 public:
  /// The sources and the options must outlive it. Errors: as of its parts.
  static Result<std::unique_ptr<OffscreenViewer>> open(const ClientOptions& options, RebuildOn on,
                                                       std::span<PoseSource* const> sources, const LogSink& log);

  Session& session() { return *session_; }
  Camera& camera() { return camera_; }
  Renderer& renderer() { return *renderer_; }
  std::string report() const { return session_->report(*renderer_, options_.width, options_.height); }

  /// Draws the next picture, and waits until it is drawn. over: what --hud writes over it, once its colours are known.
  void draw(const std::function<OverlayContent()>& over);
  /// The picture that was drawn last.
  Picture picture();

 private:
  explicit OffscreenViewer(const ClientOptions& options) : options_(options) {}
  void warm_up();
  unsigned target() { return renderer_->offscreen_target(options_.width, options_.height); }

  const ClientOptions& options_;
  // The context goes last: the members below need it current when destroyed.
  std::unique_ptr<OffscreenContext> context_;
  std::unique_ptr<Renderer> renderer_;
  RebuilderChoice rebuilder_;
  std::unique_ptr<Overlay> overlay_;
  std::unique_ptr<Session> session_;
  Camera camera_;
};

}  // namespace eigencast
