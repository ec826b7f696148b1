// SPDX-License-Identifier: MIT
#include "client/room_desk.h"

#include <gtest/gtest.h>

#include <glm/geometric.hpp>
#include <numeric>

#include "tests/unit/client/past_source.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::kBrokerUs;
using testing::kSecond;
using testing::PastSource;
using testing::sphere_asset;

/// A room that the test fills.
class FakeRoom final : public RoomClient {
 public:
  struct Shared {
    RoomState state;
    std::map<std::string, std::string> said;
    std::vector<std::string> removed;
  };
  explicit FakeRoom(Shared& shared) : shared_(shared) {}
  void read(RoomState& state) const override { state = shared_.state; }
  void say(const std::string& key, const std::string& json, bool) override { shared_.said[key] = json; }
  void remove(std::uint32_t member, const std::string& key) override {
    shared_.removed.push_back(std::to_string(member) + " " + key);
  }
  void take(const std::string& floor, bool take) override {
    shared_.state.floors[floor] = take ? shared_.state.self : 0;
  }

 private:
  Shared& shared_;
};

class RoomDeskTest : public ::testing::Test {
 protected:
  RoomDeskTest() {
    camera_.set_viewport(400, 300);
    room_.state.open = room_.state.speaks = true;
    room_.state.self = 1;
    room_.state.members[1] = {"Ada", "#ff0000"};
    room_.state.members[2] = {"Bob", "#00ff00"};
    advance();
  }
  bool advance(TimeUs by_us = 20'000) {
    ++room_.state.version;
    return desk_.advance(camera_, now_us_ += by_us);
  }
  void settle() {
    for (int i = 0; i < 100; ++i) advance();
  }

  FakeRoom::Shared room_;
  RoomDesk desk_{std::make_unique<FakeRoom>(room_)};
  Camera camera_;
  TimeUs now_us_ = 1'000'000;
};

TEST_F(RoomDeskTest, FollowsWhoLeadsUntilTheUserMoves) {
  room_.state.members[2].values["camera"] = R"({"eye":[3,1,4],"target":[0,0.5,0]})";
  settle();
  const glm::vec3 before = camera_.position();
  EXPECT_GT(glm::length(before - glm::vec3(3, 1, 4)), 0.5F) << "nobody leads";
  room_.state.floors["lead"] = 2;
  settle();
  EXPECT_LT(glm::length(camera_.position() - glm::vec3(3, 1, 4)), 0.01F);
  EXPECT_LT(glm::length(camera_.target() - glm::vec3(0, 0.5F, 0)), 0.01F);
  desk_.stop_following();
  room_.state.members[2].values["camera"] = R"({"eye":[-3,1,4],"target":[0,0,0]})";
  settle();
  EXPECT_LT(glm::length(camera_.position() - glm::vec3(3, 1, 4)), 0.01F);
  desk_.follow();
  settle();
  EXPECT_LT(glm::length(camera_.position() - glm::vec3(-3, 1, 4)), 0.01F);
}

TEST_F(RoomDeskTest, WhoeverTakesTheLeadAgainAndAgainIsNotFollowedByThoseWhoStopped) {
  desk_.stop_following();
  EXPECT_TRUE(desk_.follows()) << "nobody led";
  room_.state.floors["lead"] = 2;
  settle();
  desk_.stop_following();
  room_.state.members[3] = {"Cleo", "#0000ff"};
  for (const std::uint32_t leader : {0U, 2U, 3U, 0U, 2U}) {
    room_.state.floors["lead"] = leader;
    settle();
    EXPECT_FALSE(desk_.follows()) << leader;
  }
  desk_.follow();
  EXPECT_TRUE(desk_.follows());
}

TEST_F(RoomDeskTest, SaysItsCameraWhileItLeadsOnly) {
  settle();
  EXPECT_FALSE(room_.said.contains("camera"));
  desk_.lead(true);
  settle();
  EXPECT_TRUE(desk_.leads());
  EXPECT_NE(room_.said.at("camera"), "null");
  room_.state.floors["lead"] = 2;
  settle();
  EXPECT_EQ(room_.said.at("camera"), "null");
}

TEST_F(RoomDeskTest, WhoEntersLateGoesToTheMomentThatIsHeld) {
  room_.state.members[2].values["seek"] =
      R"({"stream":"demo","at_us":)" + std::to_string(kBrokerUs - 30 * kSecond) + R"(,"speed":0})";
  room_.state.floors["lead"] = 2;
  advance();
  PastSource source;
  std::vector<PoseSource*> sources{&source};
  Scene scene({Placement{}}, SceneOptions{});
  RewindDesk rewind;
  const auto kept = std::exchange(source.kept_, std::nullopt);
  for (TimeUs now_us = kSecond; now_us < 2 * kSecond; now_us += kSecond / 10) {
    if (now_us > 3 * kSecond / 2) source.kept_ = kept;  // It comes after what the room says.
    rewind.advance(sources, scene, now_us);
    desk_.share(rewind, sources);
  }
  ASSERT_EQ(source.seeks.size(), 1U);
  EXPECT_EQ(source.seeks[0].at_us, kBrokerUs - 30 * kSecond);
  EXPECT_EQ(source.seeks[0].speed, 0);
}

TEST_F(RoomDeskTest, CamerasOfEvilDoNothing) {
  room_.state.floors["lead"] = 2;
  const glm::vec3 before = camera_.position();
  for (const char* evil : {"", "[]", "7", R"({"eye":[1,2],"target":[0,0,0]})", R"({"eye":[1,2,"3"],"target":[0,0,0]})",
                           R"({"eye":[1,2,3],"target":[1,2,3]})", R"({"eye":[1e300,2,3],"target":[0,0,0]})"}) {
    room_.state.members[2].values["camera"] = evil;
    settle();
    EXPECT_EQ(camera_.position(), before) << evil;
  }
}

TEST(SurfacePoint, OnlyWellFormedTextsAreOne) {
  const SurfacePoint point{"demo", {7, 8, 9}, {0.5F, 0.25F, 0.25F}};
  std::string note;
  const auto again = point_from_text(text_from_point(point, "here"), &note);
  ASSERT_TRUE(again);
  EXPECT_EQ(again->stream, "demo");
  EXPECT_EQ(again->corners, point.corners);
  EXPECT_EQ(again->weights, point.weights);
  EXPECT_EQ(note, "here");
  const std::string start = R"({"stream":"demo",)";
  for (const char* evil :
       {R"("corners":[1,2],"weights":[1,0,0]})", R"("corners":[1,2,-3],"weights":[1,0,0]})",
        R"("corners":[1,2,4294967295],"weights":[1,0,0]})", R"("corners":[1,2,3],"weights":[1,1,0]})",
        R"("corners":[1,2,3],"weights":[2,-1,0]})", R"("corners":[1,2,3]})", R"("weights":[1,0,0]})"})
    EXPECT_FALSE(point_from_text(start + evil)) << evil;
  EXPECT_FALSE(point_from_text("not json"));
  std::string umlauts = "a";
  for (int i = 0; i < 250; ++i) umlauts += "\u00fc";
  ASSERT_TRUE(point_from_text(start + R"("weights":[1,0,0],"corners":[1,2,3],"note":")" + umlauts + "\"}", &note));
  EXPECT_EQ(note, umlauts.substr(0, 499)) << "whole characters: reports are UTF-8";
  EXPECT_FALSE(point_from_text(R"({"corners":[1,2,3],"weights":[1,0,0]})"));
}

TEST_F(RoomDeskTest, PinsRideOnTheMotionAtEveryLevel) {
  Asset asset = sphere_asset(3);
  std::reverse(asset.source_vertex.begin(), asset.source_vertex.end());  // The source numbers them otherwise.
  FakeSource source(asset);
  PoseSource* const sources[] = {&source};
  Scene scene({{}}, {.playout = {}, .lod = 1, .morph = false});
  const auto show = [&](std::uint64_t sequence, double stretch, double lod) {
    scene.lod().set_fraction(lod);
    scene.receive(0, source, {testing::sphere_pose(asset, sequence, now_us_ += 1000, stretch)});
    scene.advance(sources, now_us_);
  };
  show(1, 1, 1);
  camera_.set_view("front");
  camera_.set_scene({-1, -1, -1}, {1, 1, 1});
  const glm::vec2 pixel = camera_.pixel_from_scene({0.3F, 0.4F, 0.866F}).value();
  // Picked at a coarse level, with all vertices it is on a face of the source.
  show(2, 1, 0.05);
  const auto hit = pick(scene, camera_, pixel, 400, 300, sources);
  ASSERT_TRUE(hit);
  EXPECT_GT(*std::max_element(hit->rows.begin(), hit->rows.end()), scene.instances()[0].view.geometry().vertex_count());
  desk_.pin(*RoomDesk::point_of(*hit, scene, sources), "note");
  room_.state.members[2].values["pin.1"] = room_.said.at("pin.1");
  advance();
  double stretch = 1;
  for (const double lod : {0.05, 0.3, 1.0, 0.05}) {
    show(static_cast<std::uint64_t>(now_us_), stretch += 0.3, lod);
    const auto marks = desk_.marks(scene, sources);
    ASSERT_EQ(marks.size(), 1U);
    EXPECT_EQ(marks[0].text, "note");
    EXPECT_TRUE(marks[0].is_pin);
    const glm::vec3 expected{hit->at.x, hit->at.y * static_cast<float>(stretch), hit->at.z};
    EXPECT_LT(glm::length(marks[0].at - expected), 2e-5F) << lod;
  }
  // What has not arrived is not drawn; of other streams nothing is.
  source.info_->stream = "another";
  EXPECT_TRUE(desk_.marks(scene, sources).empty());
}

TEST_F(RoomDeskTest, OwnPinsAndThoseOfTheGoneCanBeRemoved) {
  Asset asset = sphere_asset(1);
  FakeSource source(asset);
  PoseSource* const sources[] = {&source};
  const std::string pin = text_from_point({"demo", {0, 1, 2}, {1, 0, 0}}, "x");
  for (std::uint32_t id : {1U, 2U, 3U}) room_.state.members[id].values = {{"pin.1", pin}, {"camera", "[]"}};
  room_.state.members[3].here = false;
  room_.state.members[2].values["pin.2"] = text_from_point({"another", {0, 1, 2}, {1, 0, 0}}, "of what is not shown");
  advance();
  const auto pins = desk_.pins(sources);
  ASSERT_EQ(pins.size(), 3U);
  EXPECT_EQ(pins[0].removable, true);
  EXPECT_EQ(pins[1].removable, false) << "Bob is here";
  EXPECT_EQ(pins[2].removable, true);
  desk_.remove(pins[0]);
  EXPECT_EQ(room_.said.at("pin.1"), "null");
  desk_.remove(pins[2]);
  EXPECT_EQ(room_.removed, std::vector<std::string>{"3 pin.1"});
}

}  // namespace
}  // namespace eigencast
