// SPDX-License-Identifier: MIT
#include "sender/studio/hand.h"

#include <gtest/gtest.h>

#include <array>
#include <glm/geometric.hpp>

namespace eigencast::studio {
namespace {

constexpr Modifiers kNone{}, kShift{true, false};

/// Six handles on the axes, seen from the front, 800 x 600.
struct Table {
  Table()
      : editor({{2, 0, 0}, {-2, 0, 0}, {0, 2, 0}, {0, -2, 0}, {0.4, 0.3, 2}, {0.4, 0.3, -2}}), hand(editor, camera) {
    camera.set_viewport(800, 600);
    camera.set_scene({-2, -2, -2}, {2, 2, 2});
    camera.set_view("front");
  }
  glm::vec2 px(const Vec3& p) const { return *camera.pixel_from_scene(glm_from(p)); }
  glm::vec2 px(std::size_t handle) const { return px(editor.handles()[handle]); }
  void drag(const glm::vec2& from, const glm::vec2& to, const Modifiers& modifiers = kNone) {
    hand.press(MouseButton::kLeft, from, modifiers);
    hand.move(0.5F * (from + to));
    hand.move(to);
    hand.release(MouseButton::kLeft);
  }
  Camera camera;
  Editor editor;
  Hand hand;
};

TEST(Picking, TakesTheHandleNearestToTheEye) {
  Table t;
  t.camera.look_from({0.4F, 0.3F, 30}, {0.4F, 0.3F, 0});  // along the line of both
  EXPECT_EQ(handle_at(t.camera, t.editor.handles(), t.px(5)), 4U);
  EXPECT_EQ(handle_at(t.camera, t.editor.handles(), t.px(0) + glm::vec2(kReachPx - 1, 0)), 0U);
  EXPECT_FALSE(handle_at(t.camera, t.editor.handles(), t.px(0) + glm::vec2(kReachPx + 1, 0)));
}

TEST(Picking, RectangleTakesWhatIsInIt) {
  Table t;
  const std::vector<std::uint32_t> right =
      handles_within(t.camera, t.editor.handles(), t.px(0) + glm::vec2(20, 20), t.px(0) - glm::vec2(20, 20));
  EXPECT_EQ(right, (std::vector<std::uint32_t>{0}));
  EXPECT_EQ(handles_within(t.camera, t.editor.handles(), {0, 0}, {800, 600}).size(), 6U);
}

TEST(Picking, HandlesBehindTheCameraAreIgnored) {
  Table t;
  t.camera.look_from({0, 0, 0.5F}, {0, 0, 0});
  for (const std::uint32_t handle : handles_within(t.camera, t.editor.handles(), {-1e6F, -1e6F}, {1e6F, 1e6F}))
    EXPECT_NE(handle, 4U);
}

TEST(Dragging, AHandleStaysUnderTheMouse) {
  for (const char* view : {"front", "iso", "top", "left"}) {
    Table t;
    t.camera.set_view(view);
    const glm::vec2 from = t.px(0), to = from + glm::vec2(-37, 61);
    const Vec3 shift = shift_in_view(t.camera, t.editor.handles()[0], from, to);
    const Vec3 moved{2 + shift[0], shift[1], shift[2]};
    EXPECT_LT(glm::length(t.px(moved) - to), 0.05F) << view;
    // In the plane that faces the camera.
    const glm::vec3 ahead = glm::normalize(t.camera.target() - t.camera.position());
    EXPECT_NEAR(glm::dot(glm_from(shift), ahead), 0, 1e-4) << view;
  }
}

TEST(Dragging, MovesTheChoiceWithTheHandle) {
  Table t;
  t.editor.choose(std::array{0U, 2U}, false);
  t.drag(t.px(0), t.px(0) + glm::vec2(50, 0));
  const double by = t.editor.handles()[0][0] - 2;
  EXPECT_GT(by, 0.1);
  EXPECT_NEAR(t.editor.handles()[2][0], by, 1e-9);
  EXPECT_EQ(t.editor.handles()[1], (Vec3{-2, 0, 0}));
  EXPECT_TRUE(t.editor.undo());
  EXPECT_EQ(t.editor.handles()[0], (Vec3{2, 0, 0}));
}

TEST(Dragging, DraggedHandleBecomesTheOnlyChoice) {
  Table t;
  t.editor.choose(std::array{0U, 2U}, false);
  t.drag(t.px(1), t.px(1) + glm::vec2(0, 40));
  EXPECT_EQ(t.editor.chosen_count(), 1U);
  EXPECT_TRUE(t.editor.is_chosen(1));
  EXPECT_EQ(t.editor.handles()[0], (Vec3{2, 0, 0}));
  EXPECT_LT(t.editor.handles()[1][1], -0.1);
}

TEST(Dragging, AClickMovesNothing) {
  Table t;
  t.drag(t.px(1), t.px(1) + glm::vec2(1, 1));
  EXPECT_EQ(t.editor.handles()[1], (Vec3{-2, 0, 0}));
  EXPECT_FALSE(t.editor.undo());
}

TEST(Dragging, BesideHandlesTurnsTheCamera) {
  Table t;
  t.editor.choose(std::array{0U}, false);
  const glm::vec3 before = t.camera.position();
  t.drag({60, 60}, {160, 60});
  EXPECT_GT(glm::length(t.camera.position() - before), 0.1F);
  EXPECT_EQ(t.editor.chosen_count(), 1U);
  t.drag({60, 60}, {60, 60});
  EXPECT_EQ(t.editor.chosen_count(), 0U);
}

TEST(Choosing, ByRectangleAddsAndByClickToggles) {
  Table t;
  t.drag(t.px(2) - glm::vec2(60, 25), t.px(2) + glm::vec2(60, 25), kShift);
  EXPECT_TRUE(t.editor.is_chosen(2));
  EXPECT_EQ(t.editor.chosen_count(), 1U);
  t.drag(t.px(1) - glm::vec2(25, 25), t.px(1) + glm::vec2(25, 25), kShift);
  EXPECT_EQ(t.editor.chosen_count(), 2U);
  t.drag(t.px(1), t.px(1), kShift);
  EXPECT_FALSE(t.editor.is_chosen(1));
}

TEST(Knobs, KeepTheirSizeOnTheScreen) {
  Table t;
  for (const float steps : {-4.0F, 0.0F, 5.0F}) {
    t.camera.zoom(steps, {400, 300});
    const Gizmo gizmo = gizmo_at(t.camera, {0, 0, 0});
    EXPECT_NEAR(glm::length(t.px(gizmo.knob(0)) - t.px(gizmo.centre)), 90, 2) << steps;
  }
}

TEST(Knobs, MoveAlongTheirAxisAlone) {
  Table t;
  const Gizmo gizmo = gizmo_at(t.camera, t.editor.centre());
  const glm::vec2 knob = t.px(gizmo.knob(0));
  t.drag(knob, knob + glm::vec2(45, 30));
  const Vec3 moved = t.editor.handles()[0];
  EXPECT_NEAR(moved[0], 2 + 0.5 * gizmo.length, 0.02 * gizmo.length);
  EXPECT_EQ(moved[1], 0);
  EXPECT_EQ(moved[2], 0);
}

TEST(Knobs, ScaleNeverTurnsInsideOut) {
  Table t;
  t.hand.command(Command::kScale);
  const glm::vec2 knob = t.px(gizmo_at(t.camera, t.editor.centre()).knob(1));
  t.drag(knob, knob - glm::vec2(0, 90));
  EXPECT_NEAR(t.editor.handles()[2][1], 4, 0.1);
  EXPECT_EQ(t.editor.handles()[0][0], 2);
  t.drag(knob, knob + glm::vec2(0, 5000));
  EXPECT_GT(t.editor.handles()[2][1], 0);
}

TEST(Knobs, RotateTwistAndBendFollowTheMouse) {
  Table t;
  t.hand.command(Command::kRotate);
  const glm::vec2 knob = t.px(gizmo_at(t.camera, t.editor.centre()).knob(1));
  t.drag(knob, knob + glm::vec2(kHalfTurnPx / 2, 0));  // a quarter turn about y: what is in front goes right
  EXPECT_NEAR(t.editor.handles()[0][2], -2, 1e-3);
  EXPECT_NEAR(t.editor.handles()[4][0], 2, 1e-3);
  t.editor.undo();

  t.hand.command(Command::kTwist);
  t.drag(knob, knob + glm::vec2(kHalfTurnPx, 0));  // half a turn between the two ends
  EXPECT_NEAR(t.editor.handles()[0][0], 2, 1e-6) << "the middle stays";
  EXPECT_NE(t.editor.handles()[4], (Vec3{0.4, 0.3, 2}));
  EXPECT_NEAR(t.editor.handles()[4][1], 0.3, 1e-6);
  t.editor.undo();

  t.hand.command(Command::kBend);
  t.drag(knob, knob + glm::vec2(kHalfTurnPx / 2, 0));
  double most = 0;
  for (std::size_t i = 0; i < 6; ++i) most = std::max(most, std::abs(t.editor.handles()[i][1] - t.editor.rest()[i][1]));
  EXPECT_LT(most, 1e-9) << "a bend about y leaves y";
  EXPECT_TRUE(t.editor.undo());
}

TEST(Hand, EscapeCancelsADrag) {
  Table t;
  t.hand.press(MouseButton::kLeft, t.px(0), kNone);
  t.hand.move(t.px(0) + glm::vec2(90, 90));
  t.hand.command(Command::kChooseNone);
  EXPECT_EQ(t.editor.handles()[0], (Vec3{2, 0, 0}));
  t.hand.move({10, 10});
  t.hand.release(MouseButton::kLeft);
  EXPECT_EQ(t.editor.handles()[0], (Vec3{2, 0, 0}));
  EXPECT_FALSE(t.editor.undo());
}

TEST(Hand, UndoWaitsForTheEndOfADrag) {
  Table t;
  t.hand.press(MouseButton::kLeft, t.px(0), kNone);
  t.hand.move(t.px(0) + glm::vec2(90, 90));
  const Vec3 there = t.editor.handles()[0];
  t.hand.command(Command::kUndo);
  EXPECT_EQ(t.editor.handles()[0], there);
  t.hand.release(MouseButton::kLeft);
  t.hand.command(Command::kUndo);
  EXPECT_EQ(t.editor.handles()[0], (Vec3{2, 0, 0}));
}

TEST(Hand, KeysMeanWhatTheHelpSays) {
  EXPECT_EQ(command_for_key("T", kNone), Command::kTwist);
  EXPECT_EQ(command_for_key("Z", {false, true}), Command::kUndo);
  EXPECT_EQ(command_for_key("Z", {true, true}), Command::kRedo);
  EXPECT_EQ(command_for_key("Y", {false, true}), Command::kRedo);
  EXPECT_FALSE(command_for_key("Z", kNone));
  EXPECT_FALSE(command_for_key("T", {false, true}));
}

TEST(Hand, MarksShowCageChoiceAndRectangle) {
  Table t;
  const std::vector<Face> faces{{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};
  t.editor.choose(std::array{1U}, false);
  Markup markup = t.hand.markup(faces);
  std::size_t edges = 0;
  for (const Markup::Line& line : markup.lines) edges += line.on_top ? 0 : 1;
  EXPECT_EQ(edges, 6U) << "each once, though two faces have it";
  EXPECT_EQ(markup.dots.size(), 6U + 3U);
  EXPECT_FALSE(markup.frame);
  t.hand.press(MouseButton::kLeft, {30, 30}, kShift);
  t.hand.move({90, 90});
  EXPECT_TRUE(t.hand.markup(faces).frame);
}

}  // namespace
}  // namespace eigencast::studio
