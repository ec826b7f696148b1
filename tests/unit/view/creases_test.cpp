// SPDX-License-Identifier: MIT
#include "view/creases.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/unit/view/cylinder.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "view/paint.h"

namespace eigencast {
namespace {

constexpr float kRightAngle = 1.5707963F;

/// The unit cube.
SurfaceGeometry cube() {
  SurfaceGeometry g;
  for (int i = 0; i < 8; ++i) {
    for (const int bit : {1, 2, 4}) g.positions.push_back((i & bit) != 0 ? 1.0F : 0.0F);
  }
  for (const auto& quad : {std::array{0U, 2U, 3U, 1U}, std::array{4U, 5U, 7U, 6U}, std::array{0U, 1U, 5U, 4U},
                           std::array{2U, 6U, 7U, 3U}, std::array{0U, 4U, 6U, 2U}, std::array{1U, 3U, 7U, 5U}}) {
    g.triangles.insert(g.triangles.end(), {quad[0], quad[1], quad[2], quad[0], quad[2], quad[3]});
  }
  for (const float x : g.positions) g.normals.push_back((2 * x - 1) / std::sqrt(3.0F));
  g.maker = g.pose_version = g.topology_version = 1;
  return g;
}

std::vector<Face> faces_of(const SurfaceGeometry& g) {
  std::vector<Face> faces;
  for (std::size_t i = 0; i < g.triangles.size(); i += 3)
    faces.push_back({g.triangles[i], g.triangles[i + 1], g.triangles[i + 2]});
  return faces;
}

TEST(Creases, AnglesAreThoseBetweenFaces) {
  const SurfaceGeometry g = cube();
  std::vector<Face> faces = faces_of(g);
  for (const float angle : crease_angles(faces, g.positions)) EXPECT_NEAR(angle, kRightAngle, 1e-5);
  for (std::size_t f = 0; f < faces.size(); f += 3) std::swap(faces[f][1], faces[f][2]);
  for (const float angle : crease_angles(faces, g.positions)) EXPECT_NEAR(angle, kRightAngle, 1e-5) << "of any winding";
  const std::vector<float> fold{0, 0, 0, 0, 1, 0, 1, 0, 0, -1, 0, 0.5, 0.5, 0.5, 9};
  const auto angles = crease_angles(std::vector<Face>{{0, 1, 2}, {1, 0, 3}}, fold);
  EXPECT_NEAR(angles[0], std::atan(0.5F), 1e-5);
  EXPECT_NEAR(angles[1], std::atan(0.5F), 1e-5);
  for (const std::size_t v : {2, 3, 4}) EXPECT_EQ(angles[v], 0) << "no edge with two faces";
  const auto three = crease_angles(std::vector<Face>{{0, 1, 2}, {1, 0, 3}, {0, 1, 4}}, fold);
  EXPECT_NEAR(three[0], 2 * kRightAngle, 1e-5);
  const std::vector<float> line{0, 0, 0, 1, 0, 0, 2, 0, 0};
  for (const float angle : crease_angles(std::vector<Face>{{0, 1, 2}, {2, 1, 0}}, line)) EXPECT_EQ(angle, 0);
}

TEST(Creases, SolidsAreClosedAndLookOutwards) {
  const SurfaceGeometry g = cube();
  const auto is_solid = [&](const std::vector<Face>& faces) {
    bool solid = false;
    crease_angles(faces, g.positions, &solid);
    return solid;
  };
  const std::vector<Face> faces = faces_of(g);
  std::vector<Face> other = faces;
  for (Face& face : other) std::swap(face[0], face[1]);
  EXPECT_NE(is_solid(faces), is_solid(other)) << "one of them looks inwards";
  other = is_solid(faces) ? faces : other;
  EXPECT_TRUE(is_solid(other));
  std::swap(other.back()[0], other.back()[1]);
  EXPECT_FALSE(is_solid(other)) << "a face is turned";
  other.pop_back();
  EXPECT_FALSE(is_solid(other)) << "a face is missing";
  EXPECT_FALSE(is_solid({}));
}

/// The cube with the file's own normals; `own` of each vertex (Asset::normals).
Asset cube_asset(std::uint8_t own) {
  const SurfaceGeometry g = cube();
  Asset asset;
  asset.vertex_count = asset.rows_ready = asset.base_count = 8;
  asset.rank = 4;
  asset.band_ends = {4};
  asset.area = 6;
  asset.rest.assign(12, 0);
  for (std::size_t d = 0; d < 3; ++d) asset.rest[3 * (d + 1) + d] = 1;
  for (std::uint32_t i = 0; i < 8; ++i) {
    asset.map.push_back(i);
    asset.source_vertex.push_back(i);
    asset.mass.push_back(0.75F);
    asset.floats.insert(asset.floats.end(), {1, g.positions[3 * i], g.positions[3 * i + 1], g.positions[3 * i + 2]});
  }
  asset.faces = faces_of(g);
  // Those of cube() look inwards.
  for (Face& face : asset.faces) std::swap(face[0], face[1]);
  asset.death.assign(asset.faces.size(), 0);
  asset.face_total = asset.faces_ready = static_cast<std::uint32_t>(asset.faces.size());
  asset.normals.assign(8, own);
  return asset;
}

class CreasedPictures : public testing::OffscreenPictures {
 protected:
  Picture draw(std::uint8_t own, Normals normals, float crease_deg = 40) {
    testing::FakeSource source(cube_asset(own));
    SceneOptions scene;
    scene.shading = {normals, crease_deg};
    SurfaceView view(scene);
    return drawn(view, source, scene.shading);
  }
  Picture drawn(SurfaceView& view, testing::FakeSource& source, const Shading& shading) {
    view.receive(source, {});
    view.set_shading(shading);
    testing::advance(view, source, ++now_);
    renderer_->upload(0, view.geometry());
    camera_.set_viewport(160, 120);
    camera_.set_view("iso");
    camera_.set_scene({0, 0, 0}, {1, 1, 1});
    RenderOptions options;
    options.normals = shading.normals;
    return renderer_->picture(camera_, options, 160, 120).value();
  }
  TimeUs now_ = 0;
  std::uint64_t paints_ = 0;
};

/// The same but for how the face's normal was found.
constexpr double kSame = 0.05;

TEST_F(CreasedPictures, SharpEdgesShowTheirFaces) {
  const Picture smooth = draw(0, Normals::kSmooth), flat = draw(0, Normals::kFlat);
  EXPECT_GT(testing::mean_difference(smooth, flat), 1);
  EXPECT_LT(testing::mean_difference(draw(0, Normals::kCrease), flat), kSame);
  EXPECT_EQ(testing::mean_difference(draw(0, Normals::kCrease, 100), smooth), 0) << "as a crease counts more";
}

TEST_F(CreasedPictures, OwnNormalsDecideWhereThereAreAny) {
  const Picture smooth = draw(0, Normals::kSmooth), flat = draw(0, Normals::kFlat);
  const auto difference = [&](std::uint8_t own, Normals normals, const Picture& other) {
    return testing::mean_difference(draw(own, normals), other);
  };
  EXPECT_LT(difference(2, Normals::kAuthored, flat), kSame);
  EXPECT_LT(testing::mean_difference(draw(2, Normals::kAuthored, 100), flat), kSame) << "whatever the angle";
  EXPECT_EQ(difference(2, Normals::kSmooth, smooth), 0);
  EXPECT_EQ(difference(1, Normals::kAuthored, smooth), 0) << "smooth, though at right angles";
  EXPECT_LT(difference(1, Normals::kCrease, flat), kSame);
  EXPECT_EQ(difference(1, Normals::kFlat, flat), 0);
  EXPECT_LT(difference(0, Normals::kAuthored, flat), kSame) << "none: by the angles";
}

TEST_F(CreasedPictures, FollowTheWishWhileNothingElseChanges) {
  testing::FakeSource source(cube_asset(0));
  SurfaceView view;
  const Picture creased = drawn(view, source, {});
  EXPECT_EQ(view.geometry().extra_normals.size(), 3U * 16);
  const Picture smooth = drawn(view, source, {Normals::kSmooth});
  EXPECT_EQ(smooth.rgb, draw(0, Normals::kSmooth).rgb);
  EXPECT_EQ(view.geometry().corners, nullptr);
  EXPECT_EQ(drawn(view, source, {Normals::kCrease}).rgb, creased.rgb);
  EXPECT_EQ(drawn(view, source, {Normals::kCrease, 100}).rgb, smooth.rgb);
  EXPECT_FALSE(testing::advance(view, source, ++now_)) << "nothing is new";
}

/// What is uploaded in parts while levels change is what is uploaded at once.
TEST_F(CreasedPictures, LevelsAreSentInParts) {
  testing::FakeSource source(testing::cylinder_asset());
  SurfaceView view;
  const auto picture = [&](std::uint64_t maker) {
    SurfaceGeometry geometry = view.geometry();
    if (maker != 0) geometry.maker = maker;
    renderer_->upload(0, geometry);
    SurfacePaint paint;
    paint.kind = SurfacePaint::Kind::kColour;
    for (std::uint32_t i = 0; i < 3 * geometry.vertex_count(); ++i)
      paint.values.push_back(static_cast<float>(i / 3 % 7) / 7);
    paint.version = ++paints_;
    renderer_->paint(0, paint);
    frame(view.facts());
    camera_.set_viewport(160, 120);
    return renderer_->picture(camera_, {}, 160, 120).value();
  };
  int pictures = 0;
  view.receive(source, {});
  for (const double part : {1.0, 0.4, 0.8, 0.3, 1.0}) {
    view.lod().set_fraction(part);
    for (int i = 0; i < 30 && testing::advance(view, source, now_ += 16'667); ++i, ++pictures) {
      const Picture in_parts = picture(0);
      ASSERT_FALSE(view.geometry().extra_normals.empty());
      ASSERT_EQ(in_parts.rgb, picture(std::numeric_limits<std::uint64_t>::max() - 7).rgb) << pictures;
      ASSERT_EQ(picture(0).rgb, in_parts.rgb);
    }
  }
  EXPECT_GT(pictures, 20);
}

}  // namespace
}  // namespace eigencast
