// SPDX-License-Identifier: MIT
#include "view/scene.h"

#include <algorithm>
#include <cassert>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <limits>
#include <optional>
#include <utility>

#include "view/camera.h"

namespace eigencast {
namespace {

constexpr float kRowGap = 0.12F;    // between surfaces of a row, of the wider one; and between rows
constexpr std::size_t kMaxRow = 6;  // more surfaces take several rows

Bounds box_in_scene(const SurfaceFacts& facts, const glm::mat4& scene_from_surface) {
  Bounds box;
  for (const glm::vec3& corner : Bounds{facts.low, facts.high}.corners())
    box.add(glm::vec3(scene_from_surface * glm::vec4(corner, 1)));
  return box;
}

/// Rows of surfaces along x, each row farther from the viewer.
class Rows {
 public:
  Rows(std::size_t surfaces, Asset::UpAxis up)
      : longest_(surfaces <= kMaxRow
                     ? kMaxRow
                     : static_cast<std::size_t>(std::ceil(std::sqrt(1.6 * static_cast<double>(surfaces))))),
        depth_(up == Asset::UpAxis::kZ ? 1 : 2),
        away_(up == Asset::UpAxis::kZ ? 1.0F : -1.0F) {}

  glm::vec3 shift(const Bounds& box) {
    if (in_row_ == longest_) {
      in_row_ = 0;
      ++row_;
      front_ = back_;
    }
    const float width = box.high.x - box.low.x, gap = kRowGap * width;
    glm::vec3 by{in_row_++ == 0 ? 0 : end_ + gap - box.low.x, 0, 0};
    end_ = box.high.x + by.x + gap;
    // Distances away from the viewer.
    const float low = std::min(away_ * box.low[depth_], away_ * box.high[depth_]);
    const float high = std::max(away_ * box.low[depth_], away_ * box.high[depth_]);
    const float back = row_ == 0 ? 0 : front_ + gap - low;
    by[depth_] = away_ * back;
    back_ = std::max(back_, high + back);
    return by;
  }

 private:
  std::size_t longest_, in_row_ = 0, row_ = 0;
  int depth_;
  float away_, end_ = 0, front_ = 0, back_ = std::numeric_limits<float>::lowest();
};

std::optional<glm::mat4> world_of(const PoseSource& source) {
  const auto& info = source.info();
  if (!info || !info->world || info->world->size() != 16) return std::nullopt;
  glm::mat4 matrix{1};
  for (int column = 0; column < 4; ++column) {
    for (int row = 0; row < 4; ++row)
      matrix[column][row] = static_cast<float>((*info->world)[static_cast<std::size_t>(4 * column + row)]);
  }
  return matrix;
}

}  // namespace

Scene::Scene(std::vector<Placement> placements, const SceneOptions& options, bool row)
    : options_(options), lod_(options.lod), row_(row) {
  for (Placement& placement : placements) add(std::move(placement));
}

void Scene::add(Placement placement) {
  Instance& instance =
      instances_.emplace_back(Instance{std::move(placement), SurfaceView(options_), glm::mat4(1), true});
  instance.scene_from_surface = instance.placement.scene_from_world;
}

void Scene::remove(std::size_t index) {
  assert(index < instances_.size());
  instances_.erase(instances_.begin() + static_cast<std::ptrdiff_t>(index));
  facts_seen_ = 0;  // recompute the box
}

void Scene::receive(std::size_t index, const PoseSource& source, const std::vector<ReceivedPose>& poses) {
  for (Instance& instance : instances_) {
    if (instance.placement.source == index) instance.view.receive(source, poses);
  }
}

/// Brokers know their own viewers alone: all streams are shown as far behind their fastest arrivals as any broker says,
/// and each broker hears what the one needs that needs most.
void Scene::keep_together(std::span<PoseSource* const> sources) {
  std::optional<TimeUs> delay_us, needed_us;
  const auto most = [](std::optional<TimeUs>& of, TimeUs us) { of = std::max(of.value_or(us), us); };
  const auto fastest_of = [](const SharedMoment& moment) { return moment.lag_us - moment.delay_us; };
  for (const Instance& instance : instances_) {
    const auto moment = sources[instance.placement.source]->moment();
    if (!moment) continue;
    most(delay_us, moment->delay_us);
    if (const auto lag_us = instance.view.playout().needed_lag_us()) most(needed_us, *lag_us - fastest_of(*moment));
  }
  for (Instance& instance : instances_) {
    PoseSource& source = *sources[instance.placement.source];
    const auto moment = source.moment();
    instance.view.set_lag(moment ? std::optional(fastest_of(*moment) + *delay_us) : std::nullopt);
    const auto own = instance.view.playout().needed_lag_us();
    if (own) source.report_late(moment && needed_us ? fastest_of(*moment) + *needed_us : *own);
  }
}

bool Scene::advance(std::span<PoseSource* const> sources, TimeUs now_us) {
  keep_together(sources);
  std::vector<Instance*> changed;
  for (Instance& instance : instances_) {
    PoseSource& source = *sources[instance.placement.source];
    instance.view.lod().set_fraction(lod_.fraction());
    instance.view.set_shading(options_.shading);
    if (!instance.view.prepare(source, now_us)) continue;
    share_basis(instance.view);
    changed.push_back(&instance);
  }
  place(sources);
  if (changed.empty()) return false;
  const auto asset_of = [&](const Instance* i) -> const Asset& { return *sources[i->placement.source]->asset(); };
  std::vector<RebuildJob> jobs;
  for (Instance* instance : changed) jobs.push_back(instance->view.job(asset_of(instance)));
  const SurfaceRebuilder::Cost cost = rebuilder().rebuild(jobs);
  for (Instance* instance : changed) instance->view.finish(asset_of(instance));
  reconstruct_us_.add(cost.positions_us);
  normals_us_.add(cost.normals_us);
  return true;
}

void Scene::share_basis(SurfaceView& view) {
  if (view.asset_id().empty()) return;
  std::weak_ptr<Reconstructor>& shared = bases_[view.asset_id()];
  const std::shared_ptr<Reconstructor> held = shared.lock();
  if (held == view.shared_reconstructor()) return;
  if (held && held->tiles().rows() >= view.reconstructor().tiles().rows()) {
    view.share(held);
  } else {
    shared = view.shared_reconstructor();  // views that have fewer rows follow at their next pose
  }
  std::erase_if(bases_, [](const auto& entry) { return entry.second.expired(); });
}

void Scene::set_rebuilder(SurfaceRebuilder* rebuilder) {
  rebuilder_ = rebuilder;
  for (Instance& instance : instances_) instance.view.forget_rebuilt();
}

void Scene::place(std::span<PoseSource* const> sources) {
  std::uint64_t seen = 0;
  Bounds all;
  std::vector<glm::vec3> outline;
  Asset::UpAxis up = Asset::UpAxis::kUnknown;
  std::optional<Rows> rows;
  for (Instance& instance : instances_) {
    const SurfaceFacts& facts = instance.view.facts();
    if (facts.version == 0) continue;
    seen += facts.version;
    if (up == Asset::UpAxis::kUnknown) up = facts.up_axis;
    const std::optional<glm::mat4> world = world_of(*sources[instance.placement.source]);
    instance.scene_from_surface = instance.placement.scene_from_world * world.value_or(glm::mat4(1));
    Bounds box = box_in_scene(facts, instance.scene_from_surface);
    if (row_ && !world) {
      if (!rows) rows.emplace(instances_.size(), up);
      const glm::vec3 shift = rows->shift(box);
      instance.scene_from_surface = glm::translate(glm::mat4(1), shift) * instance.scene_from_surface;
      box.low += shift;
      box.high += shift;
    }
    all.add(box.low);
    all.add(box.high);
    for (const glm::vec3& point : facts.outline)
      outline.emplace_back(instance.scene_from_surface * glm::vec4(point, 1));
  }
  if (seen == facts_seen_ || seen == 0) return;
  facts_seen_ = seen;
  facts_.low = all.low;
  facts_.high = all.high;
  facts_.outline = std::move(outline);
  facts_.up_axis = up;
  ++facts_.version;
}

void Scene::set_playout(const PlayoutSettings& settings) {
  options_.playout = settings;
  for (Instance& instance : instances_) instance.view.set_playout(settings);
}

std::uint64_t Scene::poses_shown() const {
  std::uint64_t largest = 0;
  for (const Instance& instance : instances_) largest = std::max(largest, instance.view.poses_shown());
  return largest;
}

std::uint64_t Scene::moves() const {
  std::uint64_t all = 0;
  for (const Instance& instance : instances_) all += instance.view.moves();
  return all;
}

std::uint64_t Scene::vertex_count() const {
  std::uint64_t count = 0;
  for (const Instance& instance : instances_) count += instance.view.geometry().vertex_count();
  return count;
}

std::uint64_t Scene::triangle_count() const {
  std::uint64_t count = 0;
  for (const Instance& instance : instances_) count += instance.view.geometry().triangles.size() / 3;
  return count;
}

Extent extent_of(const Scene::Instance& instance) {
  const SurfaceFacts& facts = instance.view.facts();
  if (facts.version == 0) return {};
  const glm::mat4& m = instance.scene_from_surface;
  const float scale = std::cbrt(std::abs(glm::determinant(glm::mat3(m))));
  return {glm::vec3(m * glm::vec4(instance.view.barycentre(), 1)), 0.5F * scale * glm::length(facts.high - facts.low),
          scale};
}

}  // namespace eigencast
