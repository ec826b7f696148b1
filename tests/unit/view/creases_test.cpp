// SPDX-License-Identifier: MIT
#include "view/creases.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/view/offscreen_pictures.h"

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
  g.maker = g.pose_version = g.topology_version = g.crease_version = 1;
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

class CreasedPictures : public testing::OffscreenPictures {
 protected:
  Picture draw(const SurfaceGeometry& geometry, Normals normals, float crease_deg = 40) {
    camera_.set_viewport(160, 120);
    camera_.set_view("iso");
    camera_.set_scene({0, 0, 0}, {1, 1, 1});
    renderer_->upload(0, geometry);
    RenderOptions options;
    options.normals = normals;
    options.crease_deg = crease_deg;
    return renderer_->picture(camera_, options, 160, 120).value();
  }
};

TEST_F(CreasedPictures, SharpEdgesShowTheirFaces) {
  SurfaceGeometry g = cube();
  const Picture smooth = draw(g, Normals::kSmooth), flat = draw(g, Normals::kFlat);
  EXPECT_GT(testing::mean_difference(smooth, flat), 1);
  EXPECT_EQ(testing::mean_difference(draw(g, Normals::kCrease), smooth), 0) << "no angles are known";
  g.creases = crease_angles(faces_of(g), g.positions);
  ++g.crease_version;
  EXPECT_EQ(testing::mean_difference(draw(g, Normals::kCrease), flat), 0);
  EXPECT_EQ(testing::mean_difference(draw(g, Normals::kCrease, 100), smooth), 0) << "as a crease counts more";
  EXPECT_EQ(testing::mean_difference(draw(g, Normals::kSmooth), smooth), 0);
}

TEST_F(CreasedPictures, OwnNormalsDecideWhereThereAreAny) {
  SurfaceGeometry g = cube();
  const Picture smooth = draw(g, Normals::kSmooth), flat = draw(g, Normals::kFlat);
  const auto difference_with = [&](float own, Normals normals, const Picture& other) {
    g.own_normals.assign(8, own);
    ++g.crease_version;
    return testing::mean_difference(draw(g, normals), other);
  };
  EXPECT_EQ(difference_with(2, Normals::kAuthored, flat), 0) << "hard, though no angles are known";
  EXPECT_EQ(difference_with(2, Normals::kCrease, smooth), 0) << "not asked for";
  EXPECT_EQ(difference_with(2, Normals::kSmooth, smooth), 0);
  g.creases = crease_angles(faces_of(g), g.positions);
  EXPECT_EQ(difference_with(1, Normals::kAuthored, smooth), 0) << "smooth, though at right angles";
  EXPECT_EQ(difference_with(1, Normals::kCrease, flat), 0);
  EXPECT_EQ(difference_with(1, Normals::kFlat, flat), 0);
  EXPECT_EQ(difference_with(0, Normals::kAuthored, flat), 0) << "none: by the angles";
}

}  // namespace
}  // namespace eigencast
