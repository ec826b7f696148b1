// SPDX-License-Identifier: MIT
#include <algorithm>

#include "common/reconstruction/reconstruct.h"
#include "tools/latency/presenter.h"
#include "view/camera.h"
#include "view/renderer.h"

namespace eigencast::latency {
namespace {

class OffscreenPresenter final : public Presenter {
 public:
  OffscreenPresenter(std::unique_ptr<OffscreenContext> context, std::unique_ptr<Renderer> renderer,
                     const PictureSize& size)
      : context_(std::move(context)), renderer_(std::move(renderer)), size_(size) {
    camera_.set_viewport(size.width, size.height);
  }

  void present(const Asset& asset, std::uint32_t N, std::span<const float> positions) override {
    const std::size_t vertices_before = surface_.positions.size();
    surface_.positions.assign(positions.begin(), positions.end());
    if (vertices_before != positions.size() || faces_ready_ != asset.faces_ready) follow(asset, N);
    surface_.normals.resize(surface_.is_point_cloud ? 0 : positions.size());
    if (!surface_.is_point_cloud) vertex_normals(positions, surface_.triangles, surface_.normals);
    ++surface_.pose_version;
    renderer_->upload(0, surface_);
    renderer_->draw(camera_, {}, size_.width, size_.height, renderer_->offscreen_target(size_.width, size_.height));
    Renderer::finish();
  }

  std::string device() const override { return renderer_->device(); }

 private:
  void follow(const Asset& asset, std::uint32_t N) {
    surface_.is_point_cloud = asset.is_point_cloud();
    surface_.triangles = triangles_at_level(asset, N);
    faces_ready_ = asset.faces_ready;
    ++surface_.topology_version;
    glm::vec3 low(surface_.positions[0], surface_.positions[1], surface_.positions[2]), high = low;
    for (std::size_t i = 0; i < surface_.positions.size(); ++i) {
      const auto axis = static_cast<glm::length_t>(i % 3);
      low[axis] = std::min(low[axis], surface_.positions[i]);
      high[axis] = std::max(high[axis], surface_.positions[i]);
    }
    camera_.set_scene(low, high);
  }

  // The context goes last: the renderer needs it current when destroyed.
  std::unique_ptr<OffscreenContext> context_;
  std::unique_ptr<Renderer> renderer_;
  const PictureSize size_;
  Camera camera_;
  SurfaceGeometry surface_;
  std::uint32_t faces_ready_ = 0;
};

}  // namespace

Result<std::unique_ptr<Presenter>> make_presenter(const PictureSize& size) {
  auto context = OffscreenContext::create();
  if (!context) return context.error();
  auto renderer = Renderer::create();
  if (!renderer) return renderer.error();
  return std::unique_ptr<Presenter>(
      std::make_unique<OffscreenPresenter>(std::move(*context), std::move(*renderer), size));
}

}  // namespace eigencast::latency
