// SPDX-License-Identifier: MIT
#include "sender/studio/thumbnail.h"

#include <memory>
#include <vector>

#include "sender/studio/local_surface.h"
#include "view/camera.h"
#include "view/renderer.h"

namespace eigencast::studio {

Result<void> write_thumbnail(const Asset& asset, std::span<const double> C, const std::string& path) {
  constexpr int kWidth = 480, kHeight = 300;
  std::unique_ptr<OffscreenContext> context;
  std::unique_ptr<Renderer> renderer;
  auto good = store(context, OffscreenContext::create());
  if (good) good = store(renderer, Renderer::create());
  if (!good) return good;
  LocalSurface surface(asset, nullptr);
  surface.set({}, C);
  std::vector<glm::vec3> points;
  Bounds box;
  const std::vector<float>& at = surface.geometry().positions;
  for (std::size_t i = 0; i + 2 < at.size(); i += 3) box.add(points.emplace_back(at[i], at[i + 1], at[i + 2]));
  renderer->upload(0, surface.geometry());
  Camera camera;
  camera.set_viewport(kWidth, kHeight);
  if (asset.up_axis == Asset::UpAxis::kX) camera.set_up(Camera::Up::kX);
  if (asset.up_axis == Asset::UpAxis::kZ) camera.set_up(Camera::Up::kZ);
  camera.set_scene(box.low, box.high, points);
  const auto picture = renderer->picture(camera, {}, kWidth, kHeight);
  return picture ? write_png(path, *picture) : picture.error();
}

}  // namespace eigencast::studio
