// SPDX-License-Identifier: MIT
#include "view/rebuilder_choice.h"

#include <algorithm>
#include <limits>
#include <random>
#include <vector>

namespace eigencast {
namespace {

constexpr std::uint32_t kSide = 128, kRank = 96;
constexpr int kRuns = 3;

/// A closed strip of kSide x kSide vertices with a basis of integers, as baked ones have.
Asset trial_asset() {
  Asset asset;
  asset.vertex_count = asset.rows_ready = kSide * kSide;
  asset.rank = kRank;
  asset.base_count = 4;
  asset.exact_columns = 1;
  asset.column_scales.assign(kRank - 1, 1.0F / 65536);
  std::minstd_rand random(1);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    asset.basis.push_back(1);
    for (std::uint32_t k = 1; k < kRank; ++k)
      asset.basis.push_back(static_cast<float>(static_cast<int>(random() % 65536) - 32768 + 1) / 65536);
    asset.map.push_back(i / 2);
    const std::uint32_t right = i % kSide + 1 == kSide ? i + 1 - kSide : i + 1;
    if (i + kSide >= asset.vertex_count) continue;
    asset.faces.push_back({i, right, i + kSide});
    asset.faces.push_back({right, right + kSide, i + kSide});
  }
  asset.death.assign(asset.faces.size(), 0);
  asset.face_total = asset.faces_ready = static_cast<std::uint32_t>(asset.faces.size());
  return asset;
}

class Stand {
 public:
  explicit Stand(Renderer& renderer) : renderer_(renderer), asset_(trial_asset()) {
    auto basis = std::make_shared<Reconstructor>();
    basis->update(asset_);
    basis_ = std::move(basis);
    for (std::uint32_t i = 0; i < 3 * kRank; ++i) C_.push_back(1.0 / (1 + i));
    level_.jump(asset_.vertex_count);
  }

  /// The fastest of kRuns, the first not counted: then shaders are compiled and the basis is sent. Stops early where it can only lose.
  TimeUs run(SurfaceRebuilder& rebuilder, TimeUs to_beat = std::numeric_limits<TimeUs>::max()) {
    SurfaceGeometry geometry;
    geometry.maker = ++made_;
    geometry.triangles = triangles_at_level(asset_, asset_.vertex_count);
    geometry.topology_version = 1;
    TimeUs best = std::numeric_limits<TimeUs>::max();
    for (int i = 0; i <= kRuns; ++i) {
      Renderer::finish();
      const TimeUs start = steady_now_us();
      const RebuildJob job{&asset_, basis_, C_, 3, kRank, &level_, 0, i == 0, &geometry};
      rebuilder.rebuild({&job, 1});
      ++geometry.pose_version;
      renderer_.upload(0, geometry);
      Renderer::finish();
      if (i == 0) continue;
      best = std::min(best, steady_now_us() - start);
      if (best / 4 > to_beat) break;
    }
    renderer_.set_surface_count(0);
    renderer_.set_surface_count(1);
    return best;
  }

 private:
  Renderer& renderer_;
  const Asset asset_;
  std::shared_ptr<const Reconstructor> basis_;
  std::vector<double> C_;
  LevelMorph level_;
  std::uint64_t made_ = 0;
};

}  // namespace

std::string_view name_of(RebuildOn on) {
  switch (on) {
    case RebuildOn::kAuto:
      return "auto";
    case RebuildOn::kCpu:
      return "cpu";
    case RebuildOn::kGpu:
      return "gpu";
  }
  return "unknown";
}

std::optional<RebuildOn> rebuild_on_from_name(std::string_view name) {
  for (const RebuildOn on : {RebuildOn::kAuto, RebuildOn::kCpu, RebuildOn::kGpu}) {
    if (name == name_of(on)) return on;
  }
  return std::nullopt;
}

Result<RebuilderChoice> choose_rebuilder(RebuildOn on, Renderer& renderer, bool finish) {
  RebuilderChoice choice;
  if (on == RebuildOn::kCpu) return choice;
  auto card = CardRebuilder::create(finish);
  if (!card) return on == RebuildOn::kAuto ? std::move(choice) : Result<RebuilderChoice>(card.error());
  if (on == RebuildOn::kAuto) {
    Stand stand(renderer);
    CpuRebuilder cpu;
    choice.trial.emplace();
    choice.trial->cpu_us = stand.run(cpu);
    choice.trial->gpu_us = stand.run(**card, choice.trial->cpu_us);
    if (!choice.trial->gpu_is_faster()) return choice;
  }
  choice.card = std::move(*card);
  return choice;
}

}  // namespace eigencast
