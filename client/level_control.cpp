// SPDX-License-Identifier: MIT
#include "client/level_control.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "common/core/text.h"

namespace eigencast {

namespace {

constexpr PictureQuality kLow{PictureQuality::kMinScale, 1, ShadowQuality::kSmall, true};
static_assert(kResolutions.back() == PictureQuality::kMinScale);
enum Knob : std::size_t { kScale, kSamples, kShadow, kGround, kKnobs };

/// One sample, and pixels drawn to one shown, along each side: more of them do a part of what four samples do.
struct OneSample {
  float scale;
  QualityKnob::Step step;
};
// Errors are by mean squares: means are of roundings, wherever pixels are scaled.
constexpr std::array<OneSample, 7> kOneSample{{{PictureQuality::kMaxScale, {0.5, 0.62}},
                                               {1.341F, {0.515, 0.7}},
                                               {1.26F, {0.53, 0.78}},
                                               {1.189F, {0.57, 0.84}},
                                               {1.122F, {0.63, 0.9}},
                                               {1.059F, {0.67, 0.95}},
                                               {1, {1, 1}}}};

/// Step 0 is four samples; from 1 on kOneSample and, between two of these, their middle.
float scale_of_samples(std::size_t step) {
  if (step == 0) return 1;
  const float below = kOneSample[step / 2].scale, above = kOneSample[(step - 1) / 2].scale;
  return std::sqrt(below * above);
}

QualityKnob samples_knob(double error, double saved) {
  QualityKnob knob{error, saved, {{0, 0}}};
  for (std::size_t step = 1; step < 2 * kOneSample.size(); ++step) {
    const QualityKnob::Step& below = kOneSample[step / 2].step;
    const QualityKnob::Step& above = kOneSample[(step - 1) / 2].step;
    knob.steps.push_back({(below.error + above.error) / 2, (below.saved + above.saved) / 2});
  }
  return knob;
}

/// What llvmpipe saves, and by how much pictures of horses and hearts change (mean of all channels, of 255), until it
/// is measured here.
std::vector<QualityKnob> usual_knobs() {
  std::vector<QualityKnob> knobs(kKnobs);
  knobs[kScale] = resolution_knob(0.25, 0.3);
  knobs[kSamples] = samples_knob(0.1, 0.35);
  knobs[kShadow] = {2.4, 0.5, {{0, 0}, {0.22, 0.5}, {1, 1}}};
  knobs[kGround] = {3.7, 0.1, {{0, 0}, {1, 1}}};
  return knobs;
}

std::vector<LevelGain> gains_of(const AssetFacts& asset) {
  std::vector<LevelError> errors;
  for (const GeometricError& error : asset.level_errors) errors.push_back({error.rows, double{error.rms}});
  return gains_from_errors(errors, asset.vertex_count);
}

/// The mean of a level's error times its vertices; 0 if the asset does not say.
double bend_of(const AssetFacts& asset) {
  double sum = 0;
  for (const GeometricError& error : asset.level_errors) sum += double{error.rms} * error.rows;
  return asset.level_errors.empty() ? 0 : sum / static_cast<double>(asset.level_errors.size());
}

PictureQuality quality_from_steps(std::span<const std::size_t> steps) {
  const std::size_t samples = steps[kSamples];
  return {kResolutions[steps[kScale]] * scale_of_samples(samples), samples == 0 ? 4 : 1,
          static_cast<ShadowQuality>(steps[kShadow]), steps[kGround] == 0};
}

}  // namespace

LevelControl::LevelControl(const LevelSettings& settings)
    : settings_(settings), quality_(settings.quality == QualityMode::kLow ? kLow : PictureQuality()) {}

std::optional<PictureQuality> LevelControl::trial() {
  tried_ = control_ && !still_ ? control_->trial() : std::nullopt;
  if (!tried_) return std::nullopt;
  std::vector<std::size_t> other = steps_;
  other[*tried_] = other[*tried_] > 0 ? 0 : control_->knobs()[*tried_].steps.size() - 1;
  return quality_from_steps(other);
}

void LevelControl::measured(double own, double other, double error) {
  if (control_ && tried_) control_->measured(*tried_, own, other, error);
}

bool LevelControl::set_still(bool still) {
  const bool sharpens = still && !still_ && lowered_;
  still_ = still;
  return sharpens;
}

std::vector<std::uint32_t> LevelControl::resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) {
  if (!control_) return resolver_->resolve(objects, last);
  QualityControl::Choice choice = control_->choose(objects, last);
  if (!choice.steps.empty()) quality_ = quality_from_steps(choice.steps);
  steps_ = std::move(choice.steps);
  return std::move(choice.levels);
}

void LevelControl::set_kind(ResolverKind kind) {
  if (kind == settings_.kind) return;
  settings_.kind = kind;
  resolver_.reset();
  control_.reset();
  if (settings_.quality == QualityMode::kAuto) quality_ = {};
}

void LevelControl::make_resolver(const Camera& camera) {
  if (settings_.kind == ResolverKind::kBudget) {
    BudgetResolver::Settings settings;
    settings.f0 = settings_.target_fps;
    settings.deadline = settings_.deadline;
    if (settings_.quality == QualityMode::kAuto) {
      const auto knobs = usual_knobs();
      control_.emplace(QualityControl::Settings{settings, knobs, kOfHalfTheVertices * knobs[kScale].error, true,
                                                settings_.least_fps});
    } else {
      control_.emplace(QualityControl::Settings{settings, {}, 0, false});
    }
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
  if (!active() || still_) {
    was_still_ = still_;
    if (settings_.quality == QualityMode::kAuto) quality_ = {};
    for (Scene::Instance& instance : instances) instance.view.set_max_vertices(std::nullopt);
    return;
  }
  std::vector<ObjectView> objects;
  std::vector<SurfaceView*> views;
  std::vector<std::vector<LevelGain>> gains;
  gains.reserve(instances.size());
  std::vector<std::pair<double, std::size_t>> known;  // Bends, and whose they are.
  for (Scene::Instance& instance : instances) {
    const Asset* asset = sources[instance.placement.source]->asset();
    if (asset == nullptr || instance.view.facts().version == 0) continue;
    objects.push_back(object_view(instance, *asset, camera, settings_.floor));
    objects.back().gains = gains.emplace_back(gains_of(*asset));
    if (!gains.back().empty()) known.emplace_back(bend_of(*asset), objects.size() - 1);
    views.push_back(&instance.view);
  }
  if (objects.empty()) return;
  if (!known.empty()) {  // What is not known is as the median of the others.
    const auto median = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
    std::nth_element(known.begin(), median, known.end());
    for (ObjectView& object : objects) {
      if (object.gains.empty()) object.gains = objects[median->second].gains;
    }
  }
  if (!has_resolver()) make_resolver(camera);
  if (std::exchange(was_still_, false)) last.reset();  // of a picture that nothing was lowered in
  const std::vector<std::uint32_t> levels = resolve(objects, last);
  lowered_ = settings_.quality == QualityMode::kAuto && quality_ != PictureQuality();
  for (std::size_t i = 0; i < views.size(); ++i) lowered_ |= levels[i] < objects[i].max;
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
