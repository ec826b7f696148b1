// SPDX-License-Identifier: MIT
// What the GPU rebuilds is what the processor does, within the tolerance that make_gpu_rebuilder() states.
#include "view/rebuild.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <span>
#include <string>
#include <tuple>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "tests/unit/reconstruction/coefficient_rounding.h"
#include "tests/unit/view/baked_heart.h"
#include "tests/unit/view/cylinder.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "view/gl_surface.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;

constexpr TimeUs kPictureUs = 16'667;

const Asset& baked(BasisKind basis, double asset_error, bool as_points, DetailKind detail = DetailKind::kNone) {
  static std::map<std::tuple<BasisKind, double, bool, DetailKind>, Asset> all;
  const auto [at, fresh] = all.try_emplace({basis, asset_error, as_points, detail});
  if (!fresh) return at->second;
  Surface surface = (*builtin_clip("heart"))->rest();
  if (as_points) surface.faces.clear();
  BakeOptions options;
  options.basis = basis;
  options.rank = 37;  // no multiple of anything
  options.asset_error = asset_error;
  options.detail = detail;
  auto result = bake(surface, options);
  EXPECT_TRUE(result);
  return at->second = std::move(result->asset);
}

/// The rest pose with every coefficient disturbed by up to a twentieth of the largest.
std::vector<double> disturbed(const Asset& asset, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> by(-0.05, 0.05);
  std::vector<double> C = asset.rest;
  double largest = 0;
  for (const double c : C) largest = std::max(largest, std::abs(c));
  for (double& c : C) c += by(random) * largest / std::sqrt(asset.rank);
  return C;
}

/// What the GPU has rebuilt. Normals may be empty. REQUIRES: geometry.gpu.
struct ReadBack {
  std::vector<float> positions, normals, extra_normals;
};
ReadBack read_back(const SurfaceGeometry& geometry) {
  assert(geometry.gpu);
  const std::size_t N = geometry.gpu_vertices;
  std::vector<float> positions(4 * N);
  ReadBack back;
  const auto get = [](const GlBuffer& buffer, std::vector<float>& values, std::size_t from = 0) {
    glBindBuffer(GL_COPY_READ_BUFFER, buffer.id());
    glGetBufferSubData(GL_COPY_READ_BUFFER, static_cast<GLintptr>(from * sizeof(float)),
                       static_cast<GLsizeiptr>(values.size() * sizeof(float)), values.data());
  };
  get(geometry.gpu->drawn(), positions);
  for (std::size_t i = 0; i < N; ++i)
    back.positions.insert(back.positions.end(), positions.begin() + 4 * static_cast<std::ptrdiff_t>(i),
                          positions.begin() + 4 * static_cast<std::ptrdiff_t>(i) + 3);
  back.normals.resize(geometry.gpu->has_normals ? 3 * N : 0);
  if (!back.normals.empty()) get(geometry.gpu->normals, back.normals);
  if (!geometry.corners) return back;
  const std::uint32_t n = geometry.corners->vertices();
  const auto origins = geometry.corners->origins(geometry.gpu_vertices);
  std::vector<float> at(4 * origins.size());
  get(geometry.gpu->drawn(), at, 4 * std::size_t{n});
  for (std::size_t e = 0; e < origins.size(); ++e) {
    for (std::size_t d = 0; d < 4; ++d) EXPECT_EQ(at[4 * e + d], positions[4 * origins[e] + d]) << "extra " << e;
  }
  back.extra_normals.resize(3 * origins.size());
  get(geometry.gpu->normals, back.extra_normals, 3 * std::size_t{n});
  return back;
}

/// Two views of one stream, the one rebuilt by the GPU, the other by the processor.
class GpuRebuilders : public testing::OffscreenPictures {
 protected:
  void SetUp() override {
    OffscreenPictures::SetUp();
    if (HasFatalFailure()) return;
    auto made = make_gpu_rebuilder();
    ASSERT_TRUE(made) << made.error().message;
    gpu_ = std::move(*made);
  }
  void TearDown() override {
    by_gpu_.reset();
    gpu_.reset();
    OffscreenPictures::TearDown();
  }

  void show(Asset asset) {
    pose_.clear();
    source_ = std::make_unique<FakeSource>(std::move(asset));
    source_->info_->epoch = 1;
    source_->info_->asset = "it";
    by_gpu_ = std::make_unique<Scene>(std::vector<Placement>(1), SceneOptions());
    by_processor_ = std::make_unique<Scene>(std::vector<Placement>(1), SceneOptions());
    by_gpu_->set_rebuilder(gpu_.get());
    for (Scene* scene : {by_gpu_.get(), by_processor_.get()}) scene->receive(0, *source_, {});
  }
  void pose(std::vector<double> C) {
    ReceivedPose pose = sphere_pose(source_->asset_, ++sequence_, now_, 1);
    pose.coefficients = std::move(C);
    for (Scene* scene : {by_gpu_.get(), by_processor_.get()}) scene->receive(0, *source_, {pose});
  }
  bool turn(double fraction, TimeUs step = kPictureUs) {
    now_ += step;
    PoseSource* const source = source_.get();
    bool changed = false;
    for (Scene* scene : {by_gpu_.get(), by_processor_.get()}) {
      scene->lod().set_fraction(fraction);
      changed |= scene->advance({&source, 1}, now_);
    }
    return changed;
  }
  static const SurfaceView& view(const Scene& scene) { return scene.instances()[0].view; }

  /// How far apart the two may be, for each axis of each vertex that is drawn.
  std::vector<std::array<double, 3>> tolerances() {
    const SurfaceView& drawn = view(*by_processor_);
    const Asset& asset = source_->asset_;
    const std::span<const double> C = drawn.coefficients();
    std::uint32_t rank = asset.rank;
    while (rank > 1 && C[3 * rank - 1] == 0 && C[3 * rank - 2] == 0 && C[3 * rank - 3] == 0) --rank;
    const testing::CoefficientRounding rounding(asset, drawn.reconstructor().tiles(), C, 3, rank);
    // Rows of an unchanged pose were rounded when there were fewer rows, which the unit depends on.
    if (!std::equal(C.begin(), C.end(), pose_.begin(), pose_.end())) roundings_.clear();
    pose_.assign(C.begin(), C.end());
    const LevelMorph& morph = drawn.morph();
    std::vector<std::array<double, 3>> magnitudes(morph.drawn()), tolerances(morph.drawn());
    roundings_.resize(std::max<std::size_t>(roundings_.size(), morph.drawn()));
    std::vector<std::array<double, 3>> moved(morph.drawn());
    for (std::uint32_t i = 0; i < morph.drawn(); ++i) {
      const std::array<double, 3> now = rounding.of(i);
      const std::uint32_t from = i < morph.whole() ? i : asset.map[i];
      for (std::size_t d = 0; d < 3; ++d) {
        for (std::uint32_t k = 0; k < rank; ++k)
          magnitudes[i][d] += std::abs(static_cast<double>(asset.entry(i, k)) * C[3 * k + d]);
        roundings_[i][d] = std::max(roundings_[i][d], now[d]);
        // A vertex on its way has its share of what the one has moved that it comes from, and holds that one's terms,
        // too.
        const double weight = double{morph.weight(i)};
        moved[i][d] = weight * roundings_[i][d] + (1 - weight) * moved[from][d];
        magnitudes[i][d] = std::max(magnitudes[i][d], magnitudes[from][d]);
        tolerances[i][d] = 2e-6 * magnitudes[i][d] + moved[i][d];
      }
    }
    return tolerances;
  }

  void expect_the_same() {
    const SurfaceGeometry &gpu = view(*by_gpu_).geometry(), &processor = view(*by_processor_).geometry();
    ASSERT_TRUE(gpu.gpu);
    ASSERT_FALSE(processor.gpu);
    EXPECT_TRUE(gpu.positions.empty());
    ASSERT_EQ(gpu.vertex_count(), processor.vertex_count());
    EXPECT_EQ(gpu.triangles, processor.triangles);
    EXPECT_EQ(gpu.radii, processor.radii);
    EXPECT_EQ(gpu.is_point_cloud, processor.is_point_cloud);
    const ReadBack back = read_back(gpu);
    ASSERT_EQ(back.positions.size(), processor.positions.size());
    ASSERT_EQ(back.normals.size(), processor.normals.size());
    EXPECT_EQ(gpu.corner_triangles, processor.corner_triangles);
    ASSERT_EQ(back.extra_normals.size(), processor.extra_normals.size());
    for (std::size_t i = 0; i < back.extra_normals.size(); i += 3) {
      const float* a = &back.extra_normals[i];
      const float* b = &processor.extra_normals[i];
      ASSERT_LT(std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]), 0.1 * M_PI / 180) << "extra normal " << i / 3;
    }
    const auto tolerance = tolerances();
    for (std::uint32_t i = 0; i < gpu.vertex_count(); ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        ASSERT_NEAR(back.positions[3 * i + d], processor.positions[3 * i + d], tolerance[i][d]) << "vertex " << i;
      }
      if (processor.normals.empty()) continue;
      const float* a = &back.normals[3 * i];
      const float* b = &processor.normals[3 * i];
      const double off = std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
      ASSERT_LT(off, 0.1 * M_PI / 180) << "normal of vertex " << i;
    }
  }

  std::unique_ptr<SurfaceRebuilder> gpu_;
  std::unique_ptr<FakeSource> source_;
  std::unique_ptr<Scene> by_gpu_, by_processor_;
  std::uint64_t sequence_ = 0;
  TimeUs now_ = 1'000'000;
  std::vector<double> pose_;
  std::vector<std::array<double, 3>> roundings_;  // that each row of pose_ may have met so far
};

TEST_F(GpuRebuilders, AgreeForEveryBasisAndLevel) {
  for (const bool as_points : {false, true}) {
    for (Asset& asset :
         std::vector<Asset>{baked(BasisKind::kAugmented, 1e-4, as_points), baked(BasisKind::kHarmonic, 1e-4, as_points),
                            baked(BasisKind::kAugmented, 0, as_points), sphere_asset(3, as_points)}) {
      SCOPED_TRACE(asset.basis_kind + " " + asset.name + (as_points ? " points" : ""));
      show(std::move(asset));
      for (const double fraction : {1.0, 0.01, 0.37}) {
        turn(fraction, 1'000'000);  // too long for a morph
        expect_the_same();
        pose(disturbed(source_->asset_, static_cast<unsigned>(100 * fraction)));
        turn(fraction);
        expect_the_same();
        if (HasFatalFailure()) return;
      }
    }
  }
}

TEST_F(GpuRebuilders, NormalsMorphAfterALargerSurface) {
  show(sphere_asset(6));
  turn(1, 1'000'000);
  expect_the_same();
  show(sphere_asset(5));
  turn(0.5, 1'000'000);
  for (int picture = 0; turn(1) && picture < 5 && !HasFatalFailure(); ++picture) expect_the_same();
}

TEST_F(GpuRebuilders, DetailIsRebuiltOnTheProcessor) {
  show(baked(BasisKind::kHarmonic, 1e-4, false, DetailKind::kFrames));
  turn(0.02, 1'000'000);
  pose(disturbed(source_->asset_, 5));
  for (const double fraction : {0.02, 0.3, 0.1}) {
    // On the way, too.
    for (int picture = 0; turn(fraction) && picture < 5; ++picture) {
      const SurfaceGeometry &gpu = view(*by_gpu_).geometry(), &processor = view(*by_processor_).geometry();
      ASSERT_FALSE(gpu.gpu);
      EXPECT_EQ(gpu.positions, processor.positions);
      EXPECT_EQ(gpu.normals, processor.normals);
      ASSERT_EQ(gpu.normals.size(), gpu.positions.size());
      for (std::size_t i = 0; i < gpu.normals.size(); i += 3)
        ASSERT_NEAR(std::hypot(gpu.normals[i], gpu.normals[i + 1], gpu.normals[i + 2]), 1, 1e-4F);
    }
  }
  turn(0.3, 1'000'000);
  turn(0.3, 1'000'000);
  const SurfaceGeometry& geometry = view(*by_gpu_).geometry();
  const Reconstructor& basis = view(*by_gpu_).reconstructor();
  const std::uint32_t N = geometry.vertex_count();
  std::vector<float> positions(3 * std::size_t{N}), normals(positions.size()), base(positions.size());
  const std::span<const double> C = view(*by_gpu_).coefficients();
  const PoseToRebuild whole{C, 3, positions, normals};
  basis.rebuild({&whole, 1}, source_->asset_.rank, N);
  basis.combine(C, 3, source_->asset_.rank, N, base);
  EXPECT_NE(positions, base);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    ASSERT_NEAR(geometry.positions[i], positions[i], 1e-4F);
    ASSERT_NEAR(geometry.normals[i], normals[i], 1e-3F);
  }
}

TEST_F(GpuRebuilders, AgreeWhileLevelsMorph) {
  for (const bool as_points : {false, true}) {
    show(baked(BasisKind::kAugmented, 1e-4, as_points));
    turn(0.05, 1'000'000);
    int pictures = 0;
    for (const double fraction : {0.9, 0.3, 1.0, 0.05}) {
      for (int picture = 0; turn(fraction) && picture < 40; ++picture, ++pictures) {
        if (picture == 3) pose(disturbed(source_->asset_, 7));  // and a new pose meanwhile
        if (picture == 5 && fraction == 0.9) turn(0.6);         // another level before the first is reached
        expect_the_same();
        if (HasFatalFailure()) return;
      }
    }
    EXPECT_GT(pictures, 30);
  }
}

TEST_F(GpuRebuilders, AgreeWhereVerticesHaveSeveralNormals) {
  show(testing::cylinder_asset());
  turn(1, 1'000'000);
  expect_the_same();
  EXPECT_EQ(view(*by_processor_).geometry().extra_normals.size(), 3U * 32);
  int pictures = 0;
  for (const double fraction : {0.4, 0.9, 0.3, 1.0}) {
    for (int picture = 0; turn(fraction) && picture < 40; ++picture, ++pictures) {
      if (picture == 3) pose(disturbed(source_->asset_, 7));
      if (picture == 7) {
        for (Scene* scene : {by_gpu_.get(), by_processor_.get()})
          scene->set_shading({fraction == 0.9 ? Normals::kSmooth : Normals::kCrease, 30});
      }
      expect_the_same();
      if (HasFatalFailure()) return;
    }
  }
  EXPECT_GT(pictures, 30);
  frame(view(*by_gpu_).facts());
  camera_.set_viewport(200, 150);
  std::vector<Picture> drawn;
  for (const Scene* scene : {by_processor_.get(), by_gpu_.get()}) {
    renderer_->upload(0, view(*scene).geometry());
    drawn.push_back(renderer_->picture(camera_, {}, 200, 150).value());
  }
  EXPECT_LT(testing::mean_difference(drawn[0], drawn[1]), 0.01);
}

TEST_F(GpuRebuilders, AgreeForFewBandsAndPartialAssets) {
  const Asset& whole = baked(BasisKind::kAugmented, 1e-4, false);
  show(whole);
  const auto arrive = [&](std::uint32_t rows) {
    source_->asset_.rows_ready = rows;
    const auto& death = whole.death;
    source_->asset_.faces_ready =
        static_cast<std::uint32_t>(std::lower_bound(death.begin(), death.end(), rows) - death.begin());
  };
  for (const double part : {0.1, 0.35, 0.99, 1.0}) {
    arrive(static_cast<std::uint32_t>(part * whole.vertex_count));
    for (int picture = 0; turn(1) && picture < 40; ++picture) expect_the_same();
    if (HasFatalFailure()) return;
  }
  std::vector<double> few = disturbed(whole, 3);
  std::fill(few.begin() + 3 * 13, few.end(), 0.0);
  pose(few);
  ASSERT_TRUE(turn(1));
  expect_the_same();
}

TEST_F(GpuRebuilders, PicturesAgree) {
  for (const bool as_points : {false, true}) {
    show(baked(BasisKind::kAugmented, 1e-4, as_points));
    pose(disturbed(source_->asset_, 5));
    turn(0.6, 1'000'000);
    frame(view(*by_gpu_).facts());
    camera_.set_viewport(200, 150);
    const auto picture = [&](const Scene& scene) {
      renderer_->upload(0, view(scene).geometry());
      return renderer_->picture(camera_, {}, 200, 150).value();
    };
    int largest = 0;
    const Picture a = picture(*by_processor_), b = picture(*by_gpu_);
    EXPECT_LT(testing::mean_difference(a, b, &largest), 0.01);
    // The other way round as well: arrays of the one must not stay behind for the other.
    EXPECT_EQ(picture(*by_processor_).rgb, a.rgb);
  }
}

TEST_F(GpuRebuilders, PositionsAreRebuiltOnRequest) {
  show(baked(BasisKind::kAugmented, 1e-4, false));
  turn(0.2, 1'000'000);
  turn(0.7);
  std::vector<float> room;
  const std::span<const float> mine = view(*by_gpu_).positions(room);
  const auto& processor = view(*by_processor_).geometry().positions;
  ASSERT_EQ(mine.size(), processor.size());
  for (std::size_t i = 0; i < mine.size(); ++i) ASSERT_NEAR(mine[i], processor[i], 1e-5F);
}

TEST_F(GpuRebuilders, InstancesOfOneAssetKeepTheirPoses) {
  constexpr TimeUs kNow = 1'000'000;
  std::vector<std::unique_ptr<testing::FakeSource>> sources;
  std::vector<PoseSource*> list;
  std::vector<Placement> placements;
  for (std::size_t i = 0; i < 5; ++i) {
    sources.push_back(std::make_unique<testing::FakeSource>(testing::baked_heart()));
    sources.back()->batches.push_back({testing::heart_pose(0.17 * static_cast<double>(i), kNow)});
    list.push_back(sources.back().get());
    placements.push_back({i, "", glm::mat4(1)});
  }
  Scene gpus(placements, {}), processors(placements, {});
  gpus.set_rebuilder(gpu_.get());
  for (std::size_t i = 0; i < list.size(); ++i) {
    const auto poses = list[i]->poll({});
    for (Scene* scene : {&gpus, &processors}) scene->receive(i, *list[i], poses);
  }
  for (Scene* scene : {&gpus, &processors}) {
    for (std::size_t i = 0; i < list.size(); ++i)
      scene->instances()[i].view.set_max_vertices(400 + 300 * static_cast<std::uint32_t>(i));
    ASSERT_TRUE(scene->advance(list, kNow));
  }
  for (std::size_t i = 0; i < list.size(); ++i) {
    const ReadBack back = read_back(gpus.instances()[i].view.geometry());
    const auto& positions = processors.instances()[i].view.geometry().positions;
    ASSERT_EQ(back.positions.size(), positions.size());
    for (std::size_t k = 0; k < positions.size(); ++k) ASSERT_NEAR(back.positions[k], positions[k], 1e-5F) << i;
    if (i == 0) continue;
    EXPECT_NE(back.positions[0], read_back(gpus.instances()[0].view.geometry()).positions[0]);
  }
}

TEST_F(GpuRebuilders, AutoTakesTheFaster) {
  const auto cpu = choose_rebuilder(RebuildOn::kCpu, *renderer_, false);
  ASSERT_TRUE(cpu);
  EXPECT_FALSE(cpu->gpu);
  EXPECT_FALSE(cpu->trial);
  const auto gpu = choose_rebuilder(RebuildOn::kGpu, *renderer_, false);
  ASSERT_TRUE(gpu) << gpu.error().message;
  EXPECT_TRUE(gpu->gpu);
  EXPECT_FALSE(gpu->trial);
  const auto measured = choose_rebuilder(RebuildOn::kAuto, *renderer_, false);
  ASSERT_TRUE(measured);
  ASSERT_TRUE(measured->trial);
  EXPECT_GT(measured->trial->cpu_us, 0);
  EXPECT_GT(measured->trial->gpu_us, 0);
  EXPECT_EQ(measured->gpu != nullptr, measured->trial->gpu_us < measured->trial->cpu_us);
}

}  // namespace
}  // namespace eigencast
