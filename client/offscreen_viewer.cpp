// SPDX-License-Identifier: MIT
#include "client/offscreen_viewer.h"

#include <limits>

namespace eigencast {

Result<std::unique_ptr<OffscreenViewer>> OffscreenViewer::open(const ClientOptions& options, RebuildOn on,
                                                               std::span<PoseSource* const> sources,
                                                               const LogSink& log) {
  std::unique_ptr<OffscreenViewer> viewer(new OffscreenViewer(options));
  auto good = store(viewer->context_, OffscreenContext::create());
  if (good) good = store(viewer->renderer_, Renderer::create());
  if (good) good = store(viewer->rebuilder_, choose_rebuilder(on, *viewer->renderer_, true));
  if (good) good = store(viewer->session_, Session::create(options, sources, log));
  if (!good) return good.error();
  viewer->session_->rebuild_with(viewer->rebuilder_);
  if (options.hud || !options.room.empty())
    viewer->overlay_ = std::make_unique<Overlay>(nullptr, text_scale(1, 1, static_cast<float>(options.ui_scale)));
  viewer->camera_.set_viewport(options.width, options.height);
  viewer->camera_.set_view(options.view);
  viewer->warm_up();
  return viewer;
}

/// Drivers compile shaders at first use; poses that come meanwhile would be lost.
void OffscreenViewer::warm_up() {
  SurfaceGeometry triangle;
  triangle.positions = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  triangle.normals = {0, 0, 1, 0, 0, 1, 0, 0, 1};
  triangle.triangles = {0, 1, 2};
  triangle.pose_version = triangle.topology_version = std::numeric_limits<std::uint64_t>::max();
  renderer_->upload(0, triangle);
  renderer_->draw(camera_, {}, options_.width, options_.height, target());
  Renderer::finish();
  renderer_->upload(0, SurfaceGeometry{});
}

void OffscreenViewer::draw(const std::function<OverlayContent()>& over) {
  session_->draw(*renderer_, camera_, options_.style, options_.width, options_.height, target());
  if (overlay_) {
    OverlayContent content = options_.hud ? over() : OverlayContent();
    content.labels = session_->labels(camera_);
    overlay_->draw(content, options_.width, options_.height, target());
  }
  session_->finish_picture(true);
}

Picture OffscreenViewer::picture() {
  return Renderer::read_back(options_.width, options_.height, target(), options_.style.transparent);
}

}  // namespace eigencast
