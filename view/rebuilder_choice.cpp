// SPDX-License-Identifier: MIT
#include <algorithm>
#include <limits>
#include <random>

#include "view/rebuild.h"
#include "view/renderer.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kSide = 128, kTrialRank = 96, kAll = kSide * kSide, kFew = kAll / 8;
constexpr int kRuns = 3;

/// A closed strip of kSide x kSide vertices with a basis of integers, as baked ones have.
Asset trial_asset() {
  Asset asset;
  asset.vertex_count = asset.rows_ready = kAll;
  asset.rank = kTrialRank;
  asset.base_count = 4;
  asset.column_scales.assign(kTrialRank - 1, 1.0F / 65536);
  std::minstd_rand random(1);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    asset.floats.push_back(1);
    for (std::uint32_t k = 1; k < kTrialRank; ++k)
      asset.integers.push_back(static_cast<std::int16_t>(static_cast<int>(random() % 65535) - 32767));
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

class TrialRun final {
 public:
  TrialRun(Renderer& renderer, SurfaceRebuilder& rebuilder, const Asset& asset,
           std::shared_ptr<const Reconstructor> basis)
      : renderer_(renderer), rebuilder_(rebuilder), asset_(asset), basis_(std::move(basis)) {
    static std::uint64_t made = 0;
    geometry_.maker = std::numeric_limits<std::uint64_t>::max() - ++made;  // apart from those of surfaces
    for (std::uint32_t i = 0; i < 3 * kTrialRank; ++i) C_.push_back(1.0 / (1 + i));
  }
  TrialRun(const TrialRun&) = delete;
  TrialRun& operator=(const TrialRun&) = delete;
  ~TrialRun() {
    renderer_.set_surface_count(0);
    renderer_.set_surface_count(1);
  }

  TimeUs once(std::uint32_t N) {
    level_.jump(N);
    geometry_.triangles.clear();
    for (std::size_t f = 0; f < 2 * std::size_t{N - kSide}; ++f)
      geometry_.triangles.insert(geometry_.triangles.end(), asset_.faces[f].begin(), asset_.faces[f].end());
    ++geometry_.topology_version;
    Renderer::finish();
    const TimeUs start = steady_now_us();
    const RebuildJob job{&asset_, basis_, C_, 3, kTrialRank, &level_, 0, true, &geometry_};
    rebuilder_.rebuild({&job, 1});
    ++geometry_.pose_version;
    renderer_.upload(0, geometry_);
    Renderer::finish();
    return steady_now_us() - start;
  }
  TimeUs fastest() {
    once(kAll);  // sends the basis
    TimeUs best = once(kAll);
    for (int i = 1; i < kRuns; ++i) best = std::min(best, once(kAll));
    return best;
  }

 private:
  Renderer& renderer_;
  SurfaceRebuilder& rebuilder_;
  const Asset& asset_;
  std::shared_ptr<const Reconstructor> basis_;
  std::vector<double> C_;
  LevelMorph level_;
  SurfaceGeometry geometry_;
};

RebuilderChoice::Trial try_both(Renderer& renderer, SurfaceRebuilder& gpu) {
  const Asset asset = trial_asset();
  auto basis = std::make_shared<Reconstructor>();
  basis->update(asset);
  CpuRebuilder cpu;
  RebuilderChoice::Trial trial;
  trial.cpu_us = TrialRun(renderer, cpu, asset, basis).fastest();
  TrialRun run(renderer, gpu, asset, basis);
  run.once(kFew);  // compiles the shaders
  trial.gpu_us = run.once(kFew);
  // Slower with an eighth of the vertices: all of them need no measuring.
  if (trial.gpu_us < trial.cpu_us) trial.gpu_us = run.fastest();
  return trial;
}

}  // namespace

Result<RebuilderChoice> choose_rebuilder(RebuildOn on, Renderer& renderer, bool finish) {
  RebuilderChoice choice;
  if (on == RebuildOn::kCpu) return choice;
  auto gpu = make_gpu_rebuilder(finish);
  if (!gpu) return on == RebuildOn::kAuto ? std::move(choice) : Result<RebuilderChoice>(gpu.error());
  if (on == RebuildOn::kAuto) {
    choice.trial = try_both(renderer, **gpu);
    if (!choice.trial->gpu_is_faster()) return choice;
  }
  choice.gpu = std::move(*gpu);
  return choice;
}

}  // namespace eigencast
