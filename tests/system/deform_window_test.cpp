// SPDX-License-Identifier: MIT
// The window of `eigencast-sender deform` on a screen of its own (Xvfb), with a real mouse (xdotool).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sender/deform/cage.h"
#include "sender/studio/hand.h"
#include "sender/surface_error.h"
#include "tests/support/paths.h"
#include "tests/system/scene.h"
#include "view/glfw_window.h"

namespace eigencast::testing {
namespace {

constexpr int kWidth = 640, kHeight = 480;

/// A screen with one window on it, and a hand.
class Desk {
 public:
  Desk(Scene& scene, const std::string& name) : scene_(scene), name_(name) {
    const std::string number = scene.file(name + ".display");
    screen_ = std::make_unique<Process>(
        std::vector<std::string>{"/bin/sh", "-c",
                                 "exec Xvfb -displayfd 3 -screen 0 800x600x24 -nolisten tcp 3>'" + number + "'"},
        scene.file(name + ".xvfb"));
    int display = -1;
    eventually([&] { return (std::ifstream(number) >> display).peek() == '\n'; });
    display_ = ":" + std::to_string(display);
  }
  void open(const std::string& to, std::vector<std::string> more = {}) {
    std::vector<std::string> all{"/usr/bin/env",
                                 "DISPLAY=" + display_,
                                 "WAYLAND_DISPLAY=",
                                 bin_dir() + "/eigencast-sender",
                                 "deform",
                                 "heart",
                                 "--to",
                                 to,
                                 "--rank",
                                 "40",
                                 "--size",
                                 std::to_string(kWidth) + "x" + std::to_string(kHeight),
                                 "--json",
                                 report_file(),
                                 "--verbose"};
    all.insert(all.end(), more.begin(), more.end());
    sender_ = std::make_unique<Process>(std::move(all), scene_.file(name_ + ".log"));
    ASSERT_TRUE(sender_->wait_for_output("live at", milliseconds(60000))) << sender_->output();
    xdotool({"search", "--sync", "--onlyvisible", "--name", "Eigencast"});
  }
  void xdotool(std::vector<std::string> arguments) {
    std::vector<std::string> all{"/usr/bin/env", "DISPLAY=" + display_, "xdotool"};
    all.insert(all.end(), arguments.begin(), arguments.end());
    Process hand(std::move(all), scene_.file("xdotool.log"));
    ASSERT_EQ(hand.wait(milliseconds(60000)), 0) << hand.output();
  }
  void drag(const glm::vec2& from, const glm::vec2& to) {
    xdotool({"mousemove", at(from.x), at(from.y), "sleep", "0.1", "mousedown", "1"});
    for (int step = 1; step <= 8; ++step) {
      const glm::vec2 p = from + (to - from) * (static_cast<float>(step) / 8);
      xdotool({"mousemove", at(p.x), at(p.y), "sleep", "0.03"});
    }
    xdotool({"mouseup", "1"});
  }
  bool sees(const std::string& text) { return sender_->wait_for_output(text, milliseconds(60000)); }
  nlohmann::json close() {
    xdotool({"key", "q"});
    EXPECT_EQ(sender_->wait(milliseconds(60000)), 0) << sender_->output();
    std::ifstream in(report_file());
    return nlohmann::json::parse(in, nullptr, false);
  }

 private:
  static std::string at(float pixel) { return std::to_string(std::lround(pixel)); }
  std::string report_file() const { return scene_.file(name_ + ".json"); }

  Scene& scene_;
  std::string name_, display_;
  std::unique_ptr<Process> screen_, sender_;
};

/// The same model, cage, camera and hand in this process: what the window should make of the same mouse.
struct Twin {
  Twin() : model(make_shape()), cage(*deform::cage_around(model, 5)), editor(cage.positions), hand(editor, camera) {
    BakeOptions options;
    options.rank = 40;
    asset = std::move(bake(model, options, std::getenv("EIGENCAST_CACHE"))->asset);
    deformer = *deform::cage_deformer(model, cage, deform::CageCoordinates::kGreen);
    camera.set_viewport(kWidth, kHeight);
    const Box box = bounding_box(model.positions);
    studio::frame(camera, studio::glm_from(box.low), studio::glm_from(box.high), cage.positions);
    camera.set_view("front");
  }
  /// As the window does when another one's heart stands beside its own.
  void make_room_beside() {
    const Box box = bounding_box(model.positions);
    const glm::vec3 low = camera.scene_low(), high = camera.scene_high(), model_low = studio::glm_from(box.low);
    const glm::vec3 shift(high.x + 0.12F * (high.x - low.x) - model_low.x, 0, 0);
    studio::frame(camera, glm::min(low, model_low + shift), glm::max(high, studio::glm_from(box.high) + shift),
                  cage.positions);
  }
  static Surface make_shape() { return (*builtin_clip("heart"))->rest(); }
  glm::vec2 knob(std::size_t axis) const {
    return round(*camera.pixel_from_scene(studio::glm_from(studio::gizmo_at(camera, editor.centre()).knob(axis))));
  }
  glm::vec2 handle(std::uint32_t i) const {
    return round(*camera.pixel_from_scene(studio::glm_from(editor.handles()[i])));
  }
  static glm::vec2 round(const glm::vec2& p) { return {std::round(p.x), std::round(p.y)}; }
  void drag(const glm::vec2& from, const glm::vec2& to) {
    hand.press(MouseButton::kLeft, from, {});
    hand.move(to);
    hand.release(MouseButton::kLeft);
  }
  /// How far what was received lies from where this hand has it, rms over the diagonal.
  double distance(const RecordedPose& pose) {
    SourceRebuilder rebuilder(asset);
    SurfaceErrorSum sum(asset.diagonal());
    const auto truth = deformer->positions(editor.handles());
    sum.add(truth, rebuilder.rebuild(pose.coefficients, pose.channels));
    return sum.result().rms;
  }
  Surface model, cage;
  Asset asset;
  std::unique_ptr<deform::Deformer> deformer;
  Camera camera;
  studio::Editor editor;
  studio::Hand hand;
};

// A software renderer shares the processor with everything else.
#define SKIP_WITHOUT_A_SCREEN() \
  if (!on_path("Xvfb") || !on_path("xdotool")) GTEST_SKIP() << "Xvfb and xdotool are not installed"

TEST(DeformWindow, AMouseDeformsWhatAViewerSees) {
  SKIP_WITHOUT_A_SCREEN();
  Scene scene;
  const auto broker = scene.start_broker();
  Desk desk(scene, "desk");
  desk.open(scene.url());
  const auto client = scene.start_client("viewer", {"--frames", "100000"});
  Twin twin;
  const auto arrives = [&](double within) {
    return eventually(
        [&] {
          const auto poses = scene.received("viewer");
          return !poses.empty() && twin.distance(poses.back()) < within;
        },
        kPatience);
  };
  ASSERT_TRUE(arrives(2e-3)) << scene.logs();

  // The knob of y with the twist: half a turn between bottom and top.
  const glm::vec2 knob = twin.knob(1), turned = knob + glm::vec2(150, 0);
  twin.hand.command(studio::Command::kTwist);
  desk.xdotool({"key", "t"});
  twin.drag(knob, turned);
  desk.drag(knob, turned);
  ASSERT_NE(twin.editor.handles()[0], twin.editor.rest()[0]);
  EXPECT_TRUE(arrives(5e-3)) << scene.logs();

  // A single handle, that nearest to the right edge of the picture.
  std::uint32_t rightmost = 0;
  for (std::uint32_t i = 0; i < twin.editor.handles().size(); ++i) {
    if (twin.handle(i).x > twin.handle(rightmost).x) rightmost = i;
  }
  const glm::vec2 handle = twin.handle(rightmost), pulled = handle + glm::vec2(30, -60);
  const std::vector<Vec3> before(twin.editor.handles().begin(), twin.editor.handles().end());
  twin.drag(handle, pulled);
  desk.drag(handle, pulled);
  ASSERT_FALSE(std::equal(before.begin(), before.end(), twin.editor.handles().begin()));
  EXPECT_TRUE(arrives(5e-3)) << scene.logs();

  // And back, both steps.
  desk.xdotool({"key", "ctrl+z", "key", "ctrl+z"});
  twin.editor.undo();
  twin.editor.undo();
  EXPECT_TRUE(arrives(2e-3)) << scene.logs();

  const nlohmann::json report = desk.close();
  ASSERT_TRUE(report.is_object());
  EXPECT_GT(report["poses_by_hand"].get<int>(), 0);
  EXPECT_GT(report["input_to_sent_us"]["count"].get<int>(), 0);
  EXPECT_GT(report["input_to_drawn_us"]["count"].get<int>(), 0);
}

TEST(DeformWindow, TwoNodesDeformAndSeeEachOther) {
  SKIP_WITHOUT_A_SCREEN();
  Scene scene;
  const auto broker = scene.start_broker();
  const std::string ann = "ws://127.0.0.1:" + scene.port() + "/live/ann",
                    bob = "ws://127.0.0.1:" + scene.port() + "/live/bob";
  Desk anns(scene, "ann"), bobs(scene, "bob");
  anns.open(ann, {"--watch", bob});
  bobs.open(bob, {"--watch", ann});
  for (Desk* desk : {&anns, &bobs}) ASSERT_TRUE(desk->sees("7292 vertices of others")) << scene.logs();
  scene.watch(ann);
  const auto of_ann = scene.start_client("of-ann", {"--frames", "100000"});
  scene.watch(bob);
  const auto of_bob = scene.start_client("of-bob", {"--frames", "100000"});

  Twin twins[2];
  for (Twin& twin : twins) twin.make_room_beside();
  twins[0].hand.command(studio::Command::kTwist);
  twins[1].hand.command(studio::Command::kScale);
  anns.xdotool({"key", "t"});
  bobs.xdotool({"key", "s"});
  const glm::vec2 knob = twins[0].knob(1), turned = knob + glm::vec2(120, 0), grown = knob - glm::vec2(0, 45);
  twins[0].drag(knob, turned);
  anns.drag(knob, turned);
  twins[1].drag(knob, grown);
  bobs.drag(knob, grown);
  const auto arrives = [&](const std::string& viewer, Twin& twin) {
    return eventually(
        [&] {
          const auto poses = scene.received(viewer);
          return !poses.empty() && twin.distance(poses.back()) < 5e-3;
        },
        kPatience);
  };
  EXPECT_TRUE(arrives("of-ann", twins[0])) << scene.logs();
  EXPECT_TRUE(arrives("of-bob", twins[1])) << scene.logs();
  for (Desk* desk : {&anns, &bobs}) {
    const nlohmann::json report = desk->close();
    ASSERT_TRUE(report.is_object()) << scene.logs();
    EXPECT_GT(report["poses_by_hand"].get<int>(), 0);
    EXPECT_GT(report["others_poses"].get<int>(), 0) << scene.logs();
  }
}

}  // namespace
}  // namespace eigencast::testing
