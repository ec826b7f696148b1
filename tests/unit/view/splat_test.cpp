// SPDX-License-Identifier: MIT
// Point clouds drawn as discs: normals and radii that are right at every level and in every pose.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "tests/unit/view/baked_heart.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "view/surface_view.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::is_clay;
using testing::OffscreenPictures;

/// The heart with its faces or as points.
const Asset& heart(bool as_points) {
  static const Asset points = [] {
    Surface surface = (*builtin_clip("heart"))->rest();
    surface.faces.clear();
    BakeOptions options;
    options.rank = 40;
    auto result = bake(surface, options);
    EXPECT_TRUE(result);
    return std::move(result->asset);
  }();
  return as_points ? points : testing::baked_heart();
}

/// The rest pose leant over and stretched: x + 0.4 y, 1.4 y, z.
std::vector<double> leant(const Asset& asset) {
  std::vector<double> C = asset.rest;
  for (std::size_t k = 0; k < asset.rank; ++k) {
    C[3 * k] += 0.4 * C[3 * k + 1];
    C[3 * k + 1] *= 1.4;
  }
  return C;
}

struct ShownHeart {
  explicit ShownHeart(bool as_points, double fraction) : source(heart(as_points)), view(options(fraction)) {
    ReceivedPose pose = testing::sphere_pose(source.asset_, 1, 1000, 1);
    pose.coefficients = leant(source.asset_);
    view.receive(source, {pose});
    testing::advance(view, source, 1000);
  }
  static SceneOptions options(double fraction) {
    SceneOptions options;
    options.lod = fraction;
    return options;
  }
  FakeSource source;
  SurfaceView view;
};

double degrees_between(const float* a, const float* b) {
  const float dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  return std::acos(std::clamp(static_cast<double>(dot), -1.0, 1.0)) * 180 / M_PI;
}

TEST(Splats, NormalsDoNotDependOnTheLevel) {
  const ShownHeart full(true, 1);
  ASSERT_EQ(full.view.geometry().normals.size(), full.view.geometry().positions.size());
  for (const double fraction : {0.02, 0.1, 0.5}) {
    const ShownHeart sparse(true, fraction);
    for (std::size_t i = 0; i < sparse.view.geometry().normals.size(); ++i)
      ASSERT_NEAR(sparse.view.geometry().normals[i], full.view.geometry().normals[i], 1e-4F);
  }
}

TEST(Splats, NormalsAreThoseOfTheDeformedSurface) {
  const ShownHeart mesh(false, 1);
  std::vector<const float*> truth(heart(false).vertex_count);
  for (std::uint32_t i = 0; i < truth.size(); ++i)
    truth[heart(false).source_vertex[i]] = &mesh.view.geometry().normals[3 * i];
  for (const double fraction : {0.03, 1.0}) {
    const ShownHeart points(true, fraction);
    const SurfaceGeometry& g = points.view.geometry();
    std::vector<double> off;
    for (std::uint32_t i = 0; i < g.vertex_count(); ++i)
      off.push_back(degrees_between(&g.normals[3 * i], truth[heart(true).source_vertex[i]]));
    std::sort(off.begin(), off.end());
    EXPECT_LT(off[off.size() / 2], 4) << fraction;
    EXPECT_LT(off[off.size() * 95 / 100], 14) << fraction;
  }
}

TEST(Splats, RadiiGrowAsPointsGo) {
  double before = 0;
  for (const double fraction : {1.0, 0.3, 0.1, 0.03}) {
    const ShownHeart points(true, fraction);
    const SurfaceGeometry& g = points.view.geometry();
    ASSERT_EQ(g.radii.size(), g.vertex_count());
    double mean = 0;
    for (const float radius : g.radii) mean += static_cast<double>(radius) / static_cast<double>(g.radii.size());
    EXPECT_GT(mean, 1.2 * before) << fraction;
    before = mean;
  }
}

TEST(Splats, CloudWithoutDiscsHasNoNormals) {
  FakeSource source(testing::sphere_asset(3, true));
  SurfaceView view;
  view.receive(source, {});
  ASSERT_TRUE(testing::advance(view, source, 0));
  EXPECT_TRUE(view.geometry().normals.empty());
  EXPECT_TRUE(view.geometry().radii.empty());
}

class SplatPictures : public OffscreenPictures {
 protected:
  static constexpr int kWidth = 320, kHeight = 240;
  void SetUp() override {
    OffscreenPictures::SetUp();
    if (HasFatalFailure()) return;
    camera_.set_viewport(kWidth, kHeight);
    camera_.set_view("iso");
  }
  Picture picture_of(const ShownHeart& shown) {
    renderer_->upload(0, shown.view.geometry());
    auto picture = renderer_->picture(camera_, {}, kWidth, kHeight).value();
    if (const char* folder = std::getenv("EIGENCAST_TEST_PICTURES")) {
      const std::string kind = shown.source.asset_.is_point_cloud() ? "points" : "mesh";
      const std::string name = kind + "_" + std::to_string(shown.view.geometry().vertex_count()) + ".png";
      EXPECT_TRUE(write_png(std::string(folder) + "/" + name, picture));
    }
    return picture;
  }
};

TEST_F(SplatPictures, SparseCloudsLookLikeTheSurface) {
  const ShownHeart mesh(false, 1);
  frame(mesh.view.facts());
  const Picture truth = picture_of(mesh);
  for (const auto& [fraction, max_off] : {std::pair(1.0, 8.0), std::pair(0.1, 14.0), std::pair(0.05, 18.0)}) {
    const Picture points = picture_of(ShownHeart(true, fraction));
    double surface = 0, holes = 0, outside = 0, off = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const std::uint8_t *a = truth.pixel(x, y), *b = points.pixel(x, y);
        if (is_clay(a)) {
          ++surface;
          holes += !is_clay(b);
          for (int c = 0; c < 3; ++c) off += std::abs(int{a[c]} - int{b[c]}) / 3.0;
        } else {
          outside += is_clay(b);
        }
      }
    }
    EXPECT_LT(holes, 0.01 * surface) << fraction;
    EXPECT_LT(outside, 0.12 * surface) << fraction;
    EXPECT_LT(off / surface, max_off) << fraction << ", of 255";
  }
}

// Of the pixels within the surface few are darker or lighter than the one before by more than its own shade ever is.
TEST_F(SplatPictures, DiscsHaveNoEdges) {
  const ShownHeart mesh(false, 1);
  frame(mesh.view.facts());
  const Picture truth = picture_of(mesh);
  const auto step = [](const Picture& picture, int x, int y) {
    int largest = 0;
    for (int c = 0; c < 3; ++c)
      largest = std::max(largest, std::abs(int{picture.pixel(x, y)[c]} - int{picture.pixel(x - 1, y)[c]}));
    return largest;
  };
  const auto is_within = [&truth](int x, int y) {
    for (const auto& [dx, dy] : {std::pair(-9, 0), std::pair(9, 0), std::pair(0, -9), std::pair(0, 9)}) {
      if (!is_clay(truth.pixel(std::clamp(x + dx, 0, kWidth - 1), std::clamp(y + dy, 0, kHeight - 1)))) return false;
    }
    return true;
  };
  for (const double fraction : {1.0, 0.1, 0.05}) {
    const Picture points = picture_of(ShownHeart(true, fraction));
    int within = 0, edges = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 1; x < kWidth; ++x) {
        if (!is_within(x, y)) continue;
        ++within;
        edges += step(points, x, y) > step(truth, x, y) + 12;
      }
    }
    ASSERT_GT(within, 5000);
    EXPECT_LT(edges, 0.005 * within) << fraction;
  }
}

}  // namespace
}  // namespace eigencast
