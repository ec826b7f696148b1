// SPDX-License-Identifier: MIT
// Point clouds drawn as discs: normals and radii that are right at every level and in every pose.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <glm/geometric.hpp>
#include <random>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
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

/// Evenly spread over the unit sphere.
std::vector<glm::vec3> directions(int count) {
  std::vector<glm::vec3> all;
  for (int i = 0; i < count; ++i) {
    const float z = 1 - (2 * static_cast<float>(i) + 1) / static_cast<float>(count), a = 2.3999632F * i;
    all.push_back(glm::vec3(std::cos(a), std::sin(a), 0) * std::sqrt(1 - z * z) + glm::vec3(0, 0, z));
  }
  return all;
}

/// Points at random on the unit sphere, baked: normals and radii are found, not given.
const Asset& random_sphere() {
  static const Asset asset = [] {
    std::mt19937 random(5);
    std::normal_distribution<double> normal;
    Surface surface;
    for (int i = 0; i < 2000; ++i) {
      const Vec3 at{normal(random), normal(random), normal(random)};
      surface.positions.push_back(unit(at));
    }
    BakeOptions options;
    options.rank = 20;
    auto result = bake(surface, options);
    EXPECT_TRUE(result);
    return std::move(result->asset);
  }();
  return asset;
}

class CloudShadows : public SplatPictures {
 protected:
  /// Towards the key light (Lighting::cast).
  glm::vec3 key() const {
    const glm::vec3 up = camera_.up_vector(), back = glm::normalize(camera_.position() - camera_.target());
    const glm::vec3 side = glm::normalize(glm::cross(up, back));
    return glm::normalize(-0.62F * side + 1.15F * up + 0.62F * glm::cross(side, up));
  }
  /// How much of the light is gone with the shadow, of 255, where that point of the scene is seen.
  int darker_at(const glm::vec3& point) const {
    const glm::vec2 at = camera_.pixel_from_scene(point).value();
    const auto x = static_cast<int>(at.x), y = static_cast<int>(at.y);
    return int{without_.pixel(x, y)[0]} - int{with_.pixel(x, y)[0]};
  }
  void draw(const SurfaceGeometry& geometry) {
    renderer_->upload(0, geometry);
    RenderOptions options;
    with_ = renderer_->picture(camera_, options, kWidth, kHeight).value();
    options.quality.shadow = ShadowQuality::kNone;
    without_ = renderer_->picture(camera_, options, kWidth, kHeight).value();
    if (const char* folder = std::getenv("EIGENCAST_TEST_PICTURES")) {
      const std::string name = std::string(folder) + "/shadow_" + std::to_string(geometry.vertex_count());
      EXPECT_TRUE(write_png(name + ".png", with_));
      EXPECT_TRUE(write_png(name + "_without.png", without_));
    }
  }
  /// Of the unit sphere's side that eye and light see, the light at less than that cosine: the share that is darker.
  double dark_share(float least_cosine) const {
    double lit = 0, dark = 0;
    for (const glm::vec3& n : directions(4000)) {
      if (glm::dot(n, key()) < least_cosine || glm::dot(n, glm::normalize(camera_.position() - n)) < 0.3F) continue;
      ++lit;
      dark += darker_at(n) > 5;
    }
    EXPECT_GT(lit, 500);
    return dark / lit;
  }
  Picture with_, without_;
};

TEST_F(CloudShadows, ARoundCloudHasNoneOnItsLitSide) {
  for (const double fraction : {1.0, 0.3, 0.1, 0.05}) {
    FakeSource source(random_sphere());
    SurfaceView view(ShownHeart::options(fraction));
    view.receive(source, {});
    ASSERT_TRUE(testing::advance(view, source, 0));
    ASSERT_FALSE(view.geometry().radii.empty());
    frame(view.facts());
    draw(view.geometry());
    EXPECT_LT(dark_share(0.2F), 0.03) << fraction;
  }
}

TEST_F(CloudShadows, NorHasOneWithoutDiscs) {
  FakeSource source(testing::sphere_asset(5, true));
  for (const double fraction : {1.0, 0.1}) {
    SurfaceView view(ShownHeart::options(fraction));
    view.receive(source, {});
    ASSERT_TRUE(testing::advance(view, source, 0));
    ASSERT_TRUE(view.geometry().radii.empty());
    frame(view.facts());
    draw(view.geometry());
    EXPECT_LT(dark_share(0.5F), 0.03) << fraction;
  }
}

// The shadow of a ball of points on points below has no holes and does not spread.
TEST_F(CloudShadows, ABallCastsOneOnPointsBelow) {
  camera_.set_scene({-2, -1, -2}, {2, 1, 2});
  for (const int along : {24, 48, 96}) {
    SurfaceGeometry geometry;
    geometry.is_point_cloud = true;
    geometry.maker = static_cast<std::uint64_t>(along);
    geometry.pose_version = geometry.level_version = 1;
    const float spacing = 4.0F / static_cast<float>(along);
    geometry.point_spacing = spacing;
    const auto add = [&](const glm::vec3& at, const glm::vec3& n) {
      geometry.positions.insert(geometry.positions.end(), {at.x, at.y, at.z});
      geometry.normals.insert(geometry.normals.end(), {n.x, n.y, n.z});
      geometry.radii.push_back(0.9F * spacing);
    };
    for (int i = 0; i <= along; ++i) {
      for (int j = 0; j <= along; ++j)
        add({spacing * static_cast<float>(i) - 2, -1, spacing * static_cast<float>(j) - 2}, {0, 1, 0});
    }
    const float radius = 0.5F;
    const glm::vec3 centre(-0.3F, 0.5F, 0.8F);
    for (const glm::vec3& n : directions(static_cast<int>(12.6F * radius * radius / (spacing * spacing))))
      add(centre + radius * n, n);
    draw(geometry);
    const glm::vec3 down = (centre.y + 1) / key().y * key(), middle = centre - down;
    for (int i = 0; i < 16; ++i) {
      const float a = 0.3926991F * static_cast<float>(i);
      const glm::vec3 around(std::cos(a), 0, std::sin(a));
      for (const float within : {0.0F, 0.15F, 0.3F})
        EXPECT_GT(darker_at(middle + within * around), 25) << along << ", " << within << " at " << a;
      EXPECT_LT(darker_at(middle + 1.1F * around), 3) << along << " at " << a;
    }
  }
}

}  // namespace
}  // namespace eigencast
