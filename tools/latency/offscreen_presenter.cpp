// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cstdio>

#include "common/reconstruction/reconstruct.h"
#include "tools/latency/presenter.h"
#include "view/camera.h"
#include "view/offscreen.h"
#include "view/renderer.h"

namespace eigencast::latency {
namespace {

constexpr int kMostPixelsASide = 8192;

class OffscreenPresenter final : public Presenter {
 public:
  OffscreenPresenter(std::unique_ptr<OffscreenContext> context, std::unique_ptr<Renderer> renderer, int width,
                     int height)
      : context_(std::move(context)), renderer_(std::move(renderer)), width_(width), height_(height) {
    camera_.set_viewport(width, height);
  }

  void present(const Asset& asset, std::uint32_t N, std::span<const float> positions) override {
    const std::size_t vertices_before = surface_.positions.size();
    surface_.positions.assign(positions.begin(), positions.end());
    if (vertices_before != positions.size() || faces_ready_ != asset.faces_ready) follow(asset, N);
    surface_.normals.resize(surface_.is_point_cloud ? 0 : positions.size());
    if (!surface_.is_point_cloud) vertex_normals(positions, surface_.triangles, surface_.normals);
    ++surface_.pose_version;
    renderer_->upload(0, surface_);
    renderer_->draw(camera_, {}, width_, height_, renderer_->offscreen_target(width_, height_));
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
  const int width_, height_;
  Camera camera_;
  SurfaceGeometry surface_;
  std::uint32_t faces_ready_ = 0;
};

}  // namespace

Result<std::unique_ptr<Presenter>> make_presenter(const std::string& size) {
  int width = 0, height = 0, end = 0;
  if (std::sscanf(size.c_str(), "%dx%d%n", &width, &height, &end) != 2 || end != static_cast<int>(size.size()) ||
      width < 1 || height < 1 || width > kMostPixelsASide || height > kMostPixelsASide)
    return fail(ErrorCode::kInvalidArgument, "--present " + size + ": must be WIDTHxHEIGHT, for example 1440x900");
  auto context = OffscreenContext::create();
  if (!context) return context.error();
  auto renderer = Renderer::create();
  if (!renderer) return renderer.error();
  return std::unique_ptr<Presenter>(
      std::make_unique<OffscreenPresenter>(std::move(*context), std::move(*renderer), width, height));
}

}  // namespace eigencast::latency
