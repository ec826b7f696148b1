// SPDX-License-Identifier: MIT
#include "sender/studio/editor.h"

#include <gtest/gtest.h>

#include <array>
#include <numbers>

namespace eigencast::studio {
namespace {

std::vector<Vec3> cube() {
  std::vector<Vec3> corners;
  for (int k = 0; k < 8; ++k) corners.push_back({k & 1 ? 1.0 : -1.0, k & 2 ? 1.0 : -1.0, k & 4 ? 1.0 : -1.0});
  return corners;
}

std::vector<Vec3> now(const Editor& editor) {
  return {editor.handles().begin(), editor.handles().end()};
}

TEST(Editor, MovesTheChosenOrAll) {
  Editor editor(cube());
  editor.choose(std::array{3U, 5U}, false);
  editor.begin();
  editor.move({0, 0, 2});
  editor.finish();
  for (std::size_t i = 0; i < 8; ++i) {
    const double by = i == 3 || i == 5 ? 2 : 0;
    EXPECT_EQ(editor.handles()[i], (Vec3{cube()[i][0], cube()[i][1], cube()[i][2] + by})) << i;
  }
  editor.choose_none();
  editor.begin();
  editor.scale({2, 1, 1});
  editor.finish();
  EXPECT_EQ(editor.box().high[0], 2);
  EXPECT_EQ(editor.box().low[0], -2);
}

TEST(Editor, StepsOfAGestureDoNotAddUp) {
  Editor once(cube()), often(cube());
  once.begin();
  once.twist(1, 1.0);
  once.finish();
  often.begin();
  for (int i = 1; i <= 1000; ++i) often.twist(1, 0.001 * i);
  often.finish();
  EXPECT_EQ(now(once), now(often));
}

TEST(Editor, AGestureIsOneStepBackAndForth) {
  Editor editor(cube());
  editor.begin();
  editor.move({1, 0, 0});
  editor.rotate(2, 0.5);
  editor.finish();
  const std::vector<Vec3> turned = now(editor);
  editor.begin();
  editor.bend({1, 0}, std::numbers::pi / 2);
  editor.finish();
  const std::vector<Vec3> bent = now(editor);
  EXPECT_NE(turned, bent);
  ASSERT_TRUE(editor.undo());
  EXPECT_EQ(now(editor), turned);
  ASSERT_TRUE(editor.undo());
  EXPECT_EQ(now(editor), cube());
  EXPECT_FALSE(editor.undo());
  ASSERT_TRUE(editor.redo());
  ASSERT_TRUE(editor.redo());
  EXPECT_EQ(now(editor), bent);
  EXPECT_FALSE(editor.redo());
}

TEST(Editor, NewStepClearsRedo) {
  Editor editor(cube());
  editor.begin();
  editor.move({1, 0, 0});
  editor.finish();
  editor.undo();
  editor.begin();
  editor.move({0, 1, 0});
  editor.finish();
  EXPECT_FALSE(editor.redo());
}

TEST(Editor, CancelledAndEmptyGesturesLeaveNoStep) {
  Editor editor(cube());
  editor.begin();
  editor.move({1, 0, 0});
  editor.cancel();
  EXPECT_EQ(now(editor), cube());
  editor.begin();
  editor.finish();
  EXPECT_FALSE(editor.undo());
}

TEST(Editor, ResetIsAStepToo) {
  Editor editor(cube());
  editor.begin();
  editor.rotate(0, 1);
  editor.finish();
  const std::vector<Vec3> turned = now(editor);
  editor.reset();
  EXPECT_EQ(now(editor), cube());
  ASSERT_TRUE(editor.undo());
  EXPECT_EQ(now(editor), turned);
}

TEST(Editor, UndoIsBounded) {
  Editor editor(cube());
  for (std::size_t i = 0; i < Editor::kMaxSteps + 10; ++i) {
    editor.begin();
    editor.move({1, 0, 0});
    editor.finish();
  }
  std::size_t steps = 0;
  while (editor.undo()) ++steps;
  EXPECT_EQ(steps, Editor::kMaxSteps);
}

TEST(Editor, TurnsAboutTheCentreOfTheChoice) {
  Editor editor(cube());
  editor.choose(std::array{1U, 3U, 5U, 7U}, false);  // x = 1
  EXPECT_EQ(editor.centre(), (Vec3{1, 0, 0}));
  editor.begin();
  editor.rotate(0, std::numbers::pi);
  editor.finish();
  EXPECT_NEAR(editor.handles()[7][1], -1, 1e-12);
  EXPECT_NEAR(editor.handles()[7][2], -1, 1e-12);
  EXPECT_EQ(editor.handles()[6], cube()[6]);
}

}  // namespace
}  // namespace eigencast::studio
