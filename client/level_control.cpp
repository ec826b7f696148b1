// SPDX-License-Identifier: MIT
#include "client/level_control.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "common/core/text.h"

namespace eigencast {

LevelControl::LevelControl(const LevelSettings& settings) : settings_(settings) {}

void LevelControl::set_kind(ResolverKind kind) {
  if (kind == settings_.kind) return;
  settings_.kind = kind;
  resolver_.reset();
}

void LevelControl::make_resolver(const Camera& camera) {
  if (settings_.kind == ResolverKind::kBudget) {
    BudgetResolver::Settings settings;
    settings.f0 = settings_.target_fps;
    settings.deadline = settings_.deadline;
    resolver_ = std::make_unique<BudgetResolver>(settings);
  } else {
    PaperResolver::Settings settings;
    settings.f0 = settings_.target_fps;
    settings.threshold = 0.15 * settings_.target_fps;  // the paper's 3 of 20
    settings.near = settings_.near.value_or(0);
    settings.far = std::max(settings_.far.value_or(4.0 * static_cast<double>(camera.scene_radius())),
                            settings.near + 1e-9 * static_cast<double>(camera.scene_radius()) + 1e-30);
    resolver_ = std::make_unique<PaperResolver>(settings);
  }
}

void LevelControl::choose(Scene& scene, std::span<PoseSource* const> sources, const Camera& camera,
                          std::optional<FrameWork> last) {
  auto& instances = scene.instances();
  for (Scene::Instance& instance : instances) {
    const Extent extent = extent_of(instance);
    instance.view.set_px_per_unit(static_cast<double>(extent.scale) *
                                  camera.max_px_per_unit(extent.barycentre, extent.radius));
  }
  if (!active()) {
    for (Scene::Instance& instance : instances) instance.view.set_max_vertices(std::nullopt);
    return;
  }
  std::vector<ObjectView> objects;
  std::vector<SurfaceView*> views;
  for (Scene::Instance& instance : instances) {
    const Asset* asset = sources[instance.placement.source]->asset();
    if (asset == nullptr || instance.view.facts().version == 0) continue;
    objects.push_back(object_view(instance, *asset, camera, settings_.floor));
    views.push_back(&instance.view);
  }
  if (objects.empty()) return;
  if (!resolver_) make_resolver(camera);
  const std::vector<std::uint32_t> levels = resolver_->resolve(objects, last);
  for (std::size_t i = 0; i < views.size(); ++i) views[i]->set_max_vertices(levels[i]);
}

ObjectView object_view(const Scene::Instance& instance, const Asset& asset, const Camera& camera, double floor) {
  const Extent extent = extent_of(instance);
  ObjectView object;
  object.max = instance.view.lod().vertices(asset);
  const auto floored = static_cast<std::uint32_t>(std::lround(floor * asset.vertex_count));
  object.min = std::min(object.max, std::max(asset.base_count, floored));
  object.distance = static_cast<double>(glm::length(extent.barycentre - camera.position()));
  object.pixels = instance.visible ? camera.diameter_px(extent.barycentre, extent.radius) : 0;
  object.vertex_cost = asset.is_point_cloud() ? 0.5 : 1;  // no normals, no faces
  object.drawn = instance.view.geometry().vertex_count();
  return object;
}

}  // namespace eigencast
