// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "common/levels/quality_control.h"
#include "web/core/core.h"
#include "web/core/error.h"

using namespace eigencast;

struct core_levels {
  QualityControl control;
  std::vector<ObjectView> objects;
  QualityControl::Choice chosen;
};

namespace {

enum Knob : std::size_t { kResolution, kSamples, kShadow, kKnobs };

constexpr std::uint32_t kMaxObjects = 4096;

bool is_usable(const core_object& object) {
  return std::isfinite(object.distance) && std::isfinite(object.pixels) && std::isfinite(object.vertex_cost) &&
         object.distance >= 0 && object.pixels >= 0 && object.vertex_cost > 0 && object.min <= object.max;
}

}  // namespace

core_levels* levels_make(double pictures_per_second, double deadline) {
  if (!(pictures_per_second >= 1 && pictures_per_second <= 1000 && deadline > 0 && deadline <= 10))
    return web::no(fail(ErrorCode::kInvalidArgument, "a rate is 1 to 1000 pictures a second, a deadline up to 10"));
  // Errors as in client/level_control.cpp. On other machines than those at hand what is saved shows by giving it up.
  constexpr double kError = 0.25;
  std::vector<QualityKnob> knobs(kKnobs);
  knobs[kResolution] = resolution_knob(kError, 0.5);
  knobs[kSamples] = {0.1, 0.35, {{0, 0}, {1, 1}}};
  knobs[kShadow] = {0.53, 0.25, {{0, 0}, {1, 1}}};  // Never none, without which surfaces float.
  QualityControl::Settings settings{{}, knobs, kOfHalfTheVertices * kError, false};
  settings.budget.f0 = pictures_per_second;
  settings.budget.deadline = deadline;
  settings.budget.used = 0.75;  // Browsers delay pictures: being in time goes before.
  return new core_levels{QualityControl(settings), {}, {std::vector<std::size_t>(kKnobs), {}}};
}

void levels_free(core_levels* levels) {
  delete levels;
}

const uint32_t* levels_resolve(core_levels* levels, const core_object* objects, uint32_t count, int64_t now_us,
                               double seconds) {
  if (count > kMaxObjects || !std::all_of(objects, objects + count, is_usable))
    return web::no(fail(ErrorCode::kInvalidArgument, "levels: too many objects, or one that is out of range"));
  levels->objects.clear();
  for (const core_object* o = objects; o != objects + count; ++o)
    levels->objects.push_back({o->max, o->min, o->distance, o->pixels, o->vertex_cost, o->drawn});
  levels->chosen = levels->control.choose(levels->objects, FrameWork{now_us, seconds});
  auto& resolved = levels->chosen.levels;
  resolved.resize(std::max<std::size_t>(resolved.size(), 1));  // Never null, even for no objects.
  return resolved.data();
}

double levels_state(const core_levels* levels) {
  return levels->control.state();
}

double levels_resolution(const core_levels* levels) {
  return double{kResolutions[levels->chosen.steps[kResolution]]};
}

uint32_t levels_samples(const core_levels* levels) {
  return static_cast<uint32_t>(levels->chosen.steps[kSamples]);
}

uint32_t levels_shadow(const core_levels* levels) {
  return static_cast<uint32_t>(levels->chosen.steps[kShadow]);
}
