// SPDX-License-Identifier: MIT
#include "sender/deform/arap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "sender/deform/moves.h"

namespace eigencast::deform {
namespace {

using ::testing::HasSubstr;

Surface bar() {
  return make_box(3, 12, 3, {1, 4, 1});
}

/// One handle for each vertex at the two ends.
std::vector<HandleGroup> ends(const Surface& model) {
  std::vector<HandleGroup> groups;
  for (std::uint32_t v = 0; v < model.vertex_count(); ++v) {
    if (std::abs(model.positions[v][1]) > 1.99) groups.push_back({v});
  }
  return groups;
}

std::vector<Vec3> settled(Deformer& deformer, std::span<const Vec3> moved, int poses = 300) {
  std::vector<Vec3> positions;
  for (int i = 0; i < poses; ++i) positions = deformer.positions(moved);
  return positions;
}

TEST(Arap, FollowsRigidMotionExactly) {
  const Surface model = bar();
  const auto deformer = arap_deformer(model, ends(model));
  ASSERT_TRUE(deformer.has_value()) << deformer.error().message;
  const std::span<const Vec3> handles = (*deformer)->handles();
  const std::vector<Vec3> same = (*deformer)->positions(handles);
  for (std::size_t v = 0; v < same.size(); ++v) EXPECT_LT(length(same[v] - model.positions[v]), 1e-12);
  const auto rigid = [](const Vec3& p) { return turned(p, {0.3, 1, 0}, 0, 0.8) + Vec3{1, 2, 3}; };
  std::vector<Vec3> moved;
  for (const Vec3& p : handles) moved.push_back(rigid(p));
  const std::vector<Vec3> positions = settled(**deformer, moved);
  for (std::size_t v = 0; v < positions.size(); ++v) EXPECT_LT(length(positions[v] - rigid(model.positions[v])), 1e-6);
  EXPECT_EQ((*deformer)->linear_map(), nullptr);
}

TEST(Arap, HoldsHandlesAndRotatesTheRest) {
  const Surface model = bar();
  const auto deformer = arap_deformer(model, ends(model));
  ASSERT_TRUE(deformer.has_value());
  const Box box = bounding_box(model.positions);
  std::vector<Vec3> moved;
  for (const Vec3& p : (*deformer)->handles()) moved.push_back(twisted(p, box, {}, std::numbers::pi / 2));
  const std::vector<Vec3> positions = settled(**deformer, moved);
  const std::vector<HandleGroup> groups = ends(model);
  for (std::size_t g = 0; g < groups.size(); ++g) EXPECT_LT(length(positions[groups[g][0]] - moved[g]), 1e-12);
  // Half-way up the cross-section is that of the rest pose: a linear blend of the ends would shrink it by 1 - cos(45
  // deg).
  double rest_width = 0, width = 0;
  for (std::size_t v = 0; v < positions.size(); ++v) {
    if (std::abs(model.positions[v][1]) > 0.2) continue;
    rest_width = std::max(rest_width, std::hypot(model.positions[v][0], model.positions[v][2]));
    width = std::max(width, std::hypot(positions[v][0], positions[v][2]));
  }
  EXPECT_GT(width, 0.93 * rest_width);
}

TEST(Arap, RefusesUnusableHandles) {
  const Surface model = bar();
  EXPECT_EQ(arap_deformer({model.positions, {}}, {{0}}).error().code, ErrorCode::kUnsupported);
  for (const std::vector<HandleGroup>& groups : std::vector<std::vector<HandleGroup>>{{{0}, {0}}, {{99999}}, {}})
    EXPECT_EQ(arap_deformer(model, groups).error().code, ErrorCode::kInvalidArgument);
  Surface two = model;
  const auto offset = static_cast<std::uint32_t>(two.vertex_count());
  for (const Vec3& p : model.positions) two.positions.push_back(p + Vec3{5, 0, 0});
  for (const Face& f : model.faces) two.faces.push_back({f[0] + offset, f[1] + offset, f[2] + offset});
  EXPECT_THAT(arap_deformer(two, {{0}}).error().message, HasSubstr("vertex " + std::to_string(offset)));
}

TEST(HandleFile, GroupsByNumberAndByBox) {
  const Surface model = bar();
  const auto groups =
      handle_groups_from_json(R"({"handles": [[3, 5], {"low": [-9, 1.99, -9], "high": [9, 9, 9]}]})", model);
  ASSERT_TRUE(groups.has_value()) << groups.error().message;
  EXPECT_EQ((*groups)[0], (HandleGroup{3, 5}));
  EXPECT_EQ((*groups)[1].size(), 16u) << "the vertices of the upper end";
  for (const char* wrong : {"", "[]", R"({"handles": 1})", R"({"handles": [[99999]]})",
                            R"({"handles": [{"low": [0]}]})", R"({"handles": [[]]})", R"({"handles": ["a"]})"}) {
    EXPECT_EQ(handle_groups_from_json(wrong, model).error().code, ErrorCode::kCorrupt) << wrong;
  }
}

}  // namespace
}  // namespace eigencast::deform
