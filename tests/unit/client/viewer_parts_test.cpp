// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>

#include "client/clip_player.h"
#include "client/clip_source.h"
#include "client/clip_truth.h"
#include "client/compared_source.h"
#include "client/connections.h"
#include "client/meters.h"
#include "client/open_source.h"
#include "client/settings.h"
#include "client/stream_list.h"
#include "client/viewer_state.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/process.h"
#include "tests/unit/view/fake_source.h"
#include "view/picture.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;

/// A clip of five frames of a sphere that grows taller, as files of this folder.
std::string growing_sphere(const testing::TemporaryFolder& folder) {
  Surface sphere = make_icosphere(2);
  for (int frame = 0; frame < 5; ++frame) {
    EXPECT_TRUE(write_surface(sphere, folder.file("f" + std::to_string(frame) + ".obj")));
    for (Vec3& p : sphere.positions) p[1] *= 1.1;
  }
  return folder.file("f*.obj");
}

TEST(WantedFrom, TellsStreamsFilesAndScenesApart) {
  EXPECT_EQ(wanted_from("  ").kind, Wanted::Kind::kNothing);
  EXPECT_EQ(wanted_from(" wss://host/a ").kind, Wanted::Kind::kStream);
  EXPECT_EQ(wanted_from(" wss://host/a\n").what, "wss://host/a");
  EXPECT_EQ(wanted_from("http://host:7490/a").kind, Wanted::Kind::kStream);
  EXPECT_EQ(wanted_from("WS://host/a").kind, Wanted::Kind::kStream);
  EXPECT_EQ(wanted_from("ftp://host/a").kind, Wanted::Kind::kStream) << "so that opening it names the known schemes";
  EXPECT_EQ(wanted_from("file:///tmp/a.obj").kind, Wanted::Kind::kClip);
  EXPECT_EQ(wanted_from("\"/tmp/my mesh.obj\"").what, "file:/tmp/my mesh.obj");
  EXPECT_EQ(wanted_from("heart").what, "file:heart");
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("s.json")) << "{}";
  EXPECT_EQ(wanted_from(folder.file("s.json")).kind, Wanted::Kind::kScene);
}

TEST(StreamList, PagesAreCheckedBeforeUse) {
  const auto page = page_from_json(
      R"({"streams":[{"stream":"lab/a","state":"live","key_rate_hz":15.5,"subscribers":3}],"next":"lab/a"})");
  ASSERT_TRUE(page) << page.error().message;
  ASSERT_EQ(page->streams.size(), 1u);
  EXPECT_EQ(page->streams[0].name, "lab/a");
  EXPECT_EQ(page->streams[0].state, "live");
  EXPECT_EQ(page->streams[0].key_rate_hz, 15.5);
  EXPECT_EQ(page->streams[0].subscribers, 3u);
  EXPECT_EQ(page->next, "lab/a");
  for (const char* bad : {"", "[]", "{}", R"({"streams":{}})", R"({"streams":[3]})", R"({"streams":[{"stream":"a"}]})",
                          R"({"streams":[{"stream":"../\u0007","state":"live"}]})",
                          R"({"streams":[{"stream":7,"state":"live"}]})", R"({"streams":[],"next":"a b"})",
                          R"({"streams":[],"next":"a"})", R"({"streams":[{"stream":"a","state":"live"}],"next":"b"})"})
    EXPECT_FALSE(page_from_json(bad)) << bad;
  EXPECT_TRUE(page_from_json(R"({"streams":[{"stream":"a","state":"live","subscribers":-1,"key_rate_hz":"x"}]})"));
}

TEST(RateMeter, WaitingForTheFirstDoesNotCount) {
  RateMeter meter;
  TimeUs now = 0;
  for (; now < 1'000'000; now += 100'000) meter.sample(0, now);
  for (std::uint64_t total = 3; total <= 15; total += 3, now += 100'000) meter.sample(total, now);
  EXPECT_NEAR(meter.per_second(), 30, 1e-9);
}

TEST(RateMeter, MeasuresGrowthOverItsWindow) {
  RateMeter meter;
  EXPECT_EQ(meter.per_second(), 0);
  for (int i = 0; i <= 300; ++i) meter.sample(static_cast<std::uint64_t>(i) * 3, i * 33'333);
  EXPECT_NEAR(meter.per_second(), 90, 2);
  meter.sample(2, 11'000'000);  // a new session counts from zero
  EXPECT_EQ(meter.per_second(), 0);
}

/// How long after the last of twenty changes, the first after a rest, it stands still. Looks every 5 ms.
TimeUs still_after(TimeUs every) {
  Stillness stillness;
  TimeUs changed = 10'000'000;
  for (int k = 0; k < 20; ++k) {
    if (k > 0) changed += every;
    EXPECT_FALSE(stillness.look(true, changed));
    for (TimeUs now = changed + 5000; k < 19 && now < changed + every; now += 5000)
      EXPECT_TRUE(!stillness.look(false, now) || k == 0) << "between two pictures of a motion of " << every << " us";
  }
  TimeUs now = changed;
  while (!stillness.look(false, now)) now += 5000;
  return now - changed;
}

TEST(Stillness, BeginsWithinATenthOfASecond) {
  for (const double fps : {13.5, 15.0, 20.0, 30.0, 60.0, 200.0})
    EXPECT_LE(still_after(static_cast<TimeUs>(1e6 / fps)), 100'000) << fps;
  Stillness stillness;
  EXPECT_FALSE(stillness.look(true, 10'000'000)) << "one turn of the wheel";
  EXPECT_TRUE(stillness.look(false, 10'100'000));
}

TEST(Stillness, SlowMotionHasToBeLate) {
  for (const TimeUs every : {100'000, 200'000, 400'000})
    EXPECT_NEAR(static_cast<double>(still_after(every)), 1.25 * static_cast<double>(every), 5000);
}

TEST(ViewerState, KeysToggleTheirSwitches) {
  ViewerState state;
  Camera camera;
  LevelOfDetail lod(0.5);
  const auto press = [&](const char* key) {
    const KeyCommand* command = command_for_key(key);
    ASSERT_NE(command, nullptr) << key;
    command->apply({state, camera, lod});
  };
  press("E");
  EXPECT_TRUE(state.style.edges);
  press(" ");
  EXPECT_TRUE(state.paused);
  press("+");
  EXPECT_DOUBLE_EQ(lod.fraction(), 0.625);
  press("-");
  EXPECT_DOUBLE_EQ(lod.fraction(), 0.5);
  press("M");
  EXPECT_EQ(state.playout.mode, PlayoutMode::kInterpolate);
  press("]");
  EXPECT_EQ(state.speed, 2);
  press("[");
  press("[");
  EXPECT_EQ(state.speed, 0.5);
  press(",");
  press(",");
  press(".");
  EXPECT_EQ(state.steps, -1);
  press("L");
  EXPECT_FALSE(state.looping);
  press("End");
  EXPECT_TRUE(state.live_wanted);
  EXPECT_DOUBLE_EQ(lod.fraction(), 0.5) << "keys of the timeline leave the detail alone";
  press("U");
  EXPECT_EQ(camera.up(), Camera::Up::kZ);
  press("F12");
  EXPECT_TRUE(state.screenshot_wanted);
  press("Escape");
  EXPECT_TRUE(state.quit);
  EXPECT_EQ(command_for_key("Z"), nullptr);
  EXPECT_EQ(command_for_key("C", {false, true})->repeats, false);
  command_for_key("F12", {true, false})->apply({state, camera, lod});
  EXPECT_TRUE(state.clean_screenshot_wanted);
  bool edges_on = false;
  for (const HelpLine& line : help_lines(state, camera, lod, ResolverKind::kNone))
    edges_on |= line.what == "edges" && line.state == "on";
  EXPECT_TRUE(edges_on);
}

/// A clip, or without timeline a stream.
class TimedSource : public FakeSource {
 public:
  explicit TimedSource(std::optional<Timeline> timeline)
      : FakeSource(sphere_asset(1)), timeline_(std::move(timeline)) {}
  Timeline* timeline() const override { return timeline_ ? &*timeline_ : nullptr; }
  mutable std::optional<Timeline> timeline_;
};

TEST(ClipPlayer, AllClipsFollowTheState) {
  TimedSource lead(Timeline({0, 100'000, 200'000, 300'000}, 400'000, 0)), shorter(Timeline({0, 100'000}, 200'000, 0));
  TimedSource stream(std::nullopt);
  const std::vector<PoseSource*> clips{&shorter, &lead}, both{&lead, &stream};
  EXPECT_EQ(leading_timeline(clips), lead.timeline());
  ViewerState state;
  TimeUs now = 250'000;
  const auto positions = [&] {
    play_clips(clips, state, now);
    return std::pair(lead.timeline()->at(now).position_us, shorter.timeline()->at(now).position_us);
  };
  EXPECT_EQ(positions(), std::pair(TimeUs{250'000}, TimeUs{50'000}));
  state.steps = -1;
  EXPECT_EQ(positions(), std::pair(TimeUs{200'000}, TimeUs{0})) << "each to a pose of its own";
  EXPECT_TRUE(state.paused);
  state.seek_us = 310'000;
  EXPECT_EQ(positions(), std::pair(TimeUs{310'000}, TimeUs{110'000})) << "the shorter one goes round";
  state.paused = false;
  state.speed = 0.5;
  positions();
  EXPECT_TRUE(lead.timeline()->interpolates()) << "slow motion is no row of stills";
  now += 20'000;
  EXPECT_EQ(positions().first, 320'000);
  state.looping = false;
  state.speed = 1;
  positions();
  now += 1'000'000;
  EXPECT_EQ(positions(), std::pair(TimeUs{300'000}, TimeUs{100'000})) << "each holds its end";
  state.paused = true;
  EXPECT_EQ(positions().first, 0) << "Space at the end begins anew";
  EXPECT_FALSE(state.paused);
  state.live_wanted = true;
  EXPECT_EQ(positions(), std::pair(TimeUs{300'000}, TimeUs{100'000}));
  EXPECT_TRUE(state.paused);
  state.live_wanted = true;
  play_clips(both, state, now);
  EXPECT_FALSE(state.paused) << "a stream is live";
  state.steps = 1;
  play_clips({}, state, now);
  EXPECT_FALSE(state.paused) << "there is nothing to step";
}

TEST(Screenshots, NeverOverwrite) {
  const testing::TemporaryFolder folder;
  const std::string prefix = folder.file("shot");
  EXPECT_EQ(next_free_name(prefix, ".png"), prefix + "_0001.png");
  std::ofstream(prefix + "_0001.png") << "x";
  EXPECT_EQ(next_free_name(prefix, ".png"), prefix + "_0002.png");
  const std::string impossible = folder.file(std::string(300, 'x'));
  EXPECT_EQ(next_free_name(impossible, ".png"), impossible + "_0001.png") << "no exception";
}

TEST(Settings, RoundTripAndIgnoreNonsense) {
  const testing::TemporaryFolder folder;
  const std::string path = folder.file("deep/viewer.json");
  Settings settings;
  settings.width = 999;
  settings.hud = false;
  settings.style.edges = true;
  settings.style.colour_map = ColourMap::kTurbo;
  settings.resolver = ResolverKind::kPaper;
  settings.playout = PlayoutMode::kEstimate;
  settings.smoothness = 0.25;
  for (int i = 0; i < 9; ++i) settings.opened("ws://h/" + std::to_string(i));
  settings.opened("ws://h/7");
  ASSERT_TRUE(settings.save(path));
  const auto back = Settings::load(path);
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->width, 999);
  EXPECT_FALSE(back->hud);
  EXPECT_TRUE(back->style.edges);
  EXPECT_EQ(back->style.colour_map, ColourMap::kTurbo);
  EXPECT_EQ(back->resolver, ResolverKind::kPaper);
  EXPECT_EQ(back->playout, PlayoutMode::kEstimate);
  EXPECT_EQ(back->smoothness, 0.25);
  ASSERT_EQ(back->recent.size(), Settings::kMaxRecent);
  EXPECT_EQ(back->recent.front(), "ws://h/7") << "once, in front";
  std::ofstream(path) << R"({"width": -3, "height": "x", "style": {"edges": 7, "colour_map": "jet"}, "recent": [1, "a"],
             "resolver": "best", "motion": 3, "smoothness": 7})";
  const auto odd = Settings::load(path);
  ASSERT_TRUE(odd);
  EXPECT_EQ(odd->width, 1280);
  EXPECT_FALSE(odd->style.edges);
  EXPECT_EQ(odd->style.colour_map, ColourMap::kViridis);
  EXPECT_FALSE(odd->resolver || odd->playout || odd->smoothness);
  EXPECT_EQ(odd->recent, (std::vector<std::string>{"a"}));
  std::ofstream(path) << "no json";
  EXPECT_EQ(Settings::load(path).error().code, ErrorCode::kCorrupt);
  EXPECT_TRUE(Settings::load(folder.file("none.json")));
}

TEST(History, KeepsAMinuteOfSamples) {
  History history;
  EXPECT_TRUE(history.add({1, 0, 0, 0, 0}, 1'000'000));
  EXPECT_FALSE(history.add({1, 0, 0, 0, 0}, 1'010'000));
  for (int i = 1; i < 1000; ++i) history.add({0, static_cast<double>(i), 0, 0, 0}, 1'000'000 + i * History::kEveryUs);
  EXPECT_EQ(history.size(), History::kMaxSamples);
  EXPECT_EQ(history.values(&HistorySample::drawn_hz).back(), 999);
  EXPECT_EQ(axis_for({0.3F, 0.21F}), (std::array<float, 2>{0, 0.3F}));
  EXPECT_EQ(axis_for({}), (std::array<float, 2>{0, 1}));
}

TEST(Pick, HitsTheNearSideOnly) {
  FakeSource source(sphere_asset(4));
  Scene scene({{}}, {});
  PoseSource* const sources[] = {&source};
  scene.receive(0, source, {});
  scene.advance(sources, 0);
  Camera camera;
  camera.set_viewport(400, 300);
  camera.set_view("front");
  camera.set_scene({-1, -1, -1}, {1, 1, 1});
  const auto hit = pick(scene, camera, {200, 150}, 400, 300);
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->at.z, 1, 0.02);
  EXPECT_NEAR(hit->at.x, 0, 0.01);
  const glm::vec3 aside{0.5F, 0.5F, std::sqrt(0.5F)};
  const auto there = pick(scene, camera, camera.pixel_from_scene(aside).value(), 400, 300);
  ASSERT_TRUE(there);
  EXPECT_NEAR(there->at.x, aside.x, 0.02);
  EXPECT_NEAR(there->at.y, aside.y, 0.02);
  std::vector<float> room;
  const glm::vec3 again = scene.instances().front().view.point(there->rows, there->weights, room);
  EXPECT_LT(glm::length(again - there->at), 1e-5F) << "where the ray meets the triangle";
  EXPECT_FALSE(pick(scene, camera, {2, 2}, 400, 300));
  scene.instances().front().visible = false;
  EXPECT_FALSE(pick(scene, camera, {200, 150}, 400, 300));
}

TEST(ClipTruths, FindTheMomentAndMeasureTheDistance) {
  const testing::TemporaryFolder folder;
  const auto clip = BakedClip::open(growing_sphere(folder), "");
  ASSERT_TRUE(clip) << clip.error().message;
  ClipSource source(*clip, 0, [] { return TimeUs{0}; });
  auto* truth = dynamic_cast<ClipTruth*>(source.truth());
  ASSERT_NE(truth, nullptr);
  const auto& frames = (*clip)->frames;
  EXPECT_EQ(truth->moment_of(frames[2], 3).part, 0);
  std::vector<double> between = frames[1];
  for (std::size_t i = 0; i < between.size(); ++i) between[i] = 0.75 * frames[1][i] + 0.25 * frames[2][i];
  const auto moment = truth->moment_of(between, 3);
  EXPECT_EQ(moment.first, 1u);
  EXPECT_NEAR(moment.part, 0.25, 1e-9);

  // What was rebuilt exactly is off by nothing; moved by d, by d.
  const auto pose = (*clip)->motion->pose(3);
  ASSERT_TRUE(pose);
  std::vector<float> positions, errors(100);
  for (std::size_t i = 0; i < errors.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d)
      positions.push_back(static_cast<float>((*pose)[(*clip)->asset.source_vertex[i]][d] - (*clip)->asset.origin[d] +
                                             (d == 1 ? 0.125 : 0)));
  }
  ASSERT_TRUE(truth->errors(frames[3], 3, {}, positions, errors));
  for (const float error : errors) EXPECT_NEAR(error, 0.125, 1e-5);
  EXPECT_FALSE(truth->errors(std::vector<double>(9), 3, {}, positions, errors));
  EXPECT_FALSE(truth->why().empty()) << "the truth of another surface";
}

TEST(ClipTruths, StreamsGetTheirTruthInTheBackground) {
  const testing::TemporaryFolder folder;
  const std::string files = growing_sphere(folder);
  const auto clip = BakedClip::open(files, "");
  ASSERT_TRUE(clip);
  const auto until = [](PoseSource& source, const std::function<bool()>& done) {
    for (int i = 0; i < 1000 && !done(); ++i) source.poll(std::chrono::milliseconds(10));
    return done();
  };
  const auto right = with_truth(std::make_unique<ClipSource>(*clip), files);
  std::vector<float> errors(10), positions(30);
  EXPECT_TRUE(until(*right, [&] { return right->truth()->errors((*clip)->frames[0], 3, {}, positions, errors); }))
      << right->truth()->why();
  const auto wrong = with_truth(std::make_unique<ClipSource>(*clip), "sphere");
  EXPECT_TRUE(until(*wrong, [&] { return wrong->truth()->why().find("10242") != std::string::npos; }))
      << "names the number of vertices: " << wrong->truth()->why();
}

/// Two sources of one sphere, and what compares the first with the second.
struct TwoSpheres {
  explicit TwoSpheres(const std::string& other = "one") {
    auto a = std::make_unique<testing::FakeSource>(testing::sphere_asset(2));
    auto b = std::make_unique<testing::FakeSource>(testing::sphere_asset(2));
    first = a.get(), second = b.get();
    for (auto* source : {first, second}) source->info_->epoch = 1;
    first->info_->asset = "one", second->info_->asset = other;
    both = compared(std::move(a), std::move(b));
  }
  /// Pose f is moved by f / 8.
  static ReceivedPose pose(const Asset& asset, int f, TimeUs capture_us, TimeUs arrival_us) {
    ReceivedPose made = testing::sphere_pose(asset, static_cast<std::uint64_t>(f), capture_us, 1, f / 8.0);
    made.arrival_us = arrival_us;
    return made;
  }
  /// Of the first eight poses: capture times of the second are those of `shift_us` later.
  void give(int ahead, TimeUs shift_us, TimeUs later_us) {
    for (int f = 0; f < 8; ++f) {
      const TimeUs at_us = 1'000'000 + f * 32'000;
      first->batches.push_back({pose(first->asset_, f, at_us, at_us + 1'000)});
      second->batches.push_back({pose(second->asset_, f + ahead, at_us + shift_us, at_us + later_us)});
    }
    while (!first->batches.empty()) (void)both->poll(std::chrono::milliseconds(0));
  }
  bool measure(double shift, TimeUs capture_us) {
    const ReceivedPose shown = testing::sphere_pose(first->asset_, 0, capture_us, 1, shift);
    const std::span<const double> C(shown.coefficients.begin(), shown.coefficients.end());
    return both->truth()->errors(C, 3, capture_us, positions, errors);
  }

  testing::FakeSource *first, *second;
  std::unique_ptr<PoseSource> both;
  std::vector<float> errors = std::vector<float>(162), positions = std::vector<float>(486);
};

TEST(Comparisons, AreOfOneCaptureTimeWhereClocksAreOne) {
  TwoSpheres spheres;
  EXPECT_FALSE(spheres.measure(0, 1'000'000)) << "nothing has come";
  EXPECT_FALSE(spheres.both->truth()->why().empty());
  spheres.give(1, 0, 9'000);  // the second is a pose ahead, and its poses take longer
  ASSERT_TRUE(spheres.measure(2 / 8.0, 1'064'000)) << spheres.both->truth()->why();
  for (const float error : spheres.errors) EXPECT_NEAR(error, 1 / 8.0, 1e-6);
  const auto difference = spheres.both->truth()->difference();
  ASSERT_TRUE(difference);
  EXPECT_NEAR(difference->largest, 1 / 8.0 / spheres.first->asset_.diagonal(), 1e-6);
  EXPECT_NEAR(difference->rms, 1 / 8.0 / std::sqrt(spheres.first->asset_.area) / spheres.first->asset_.diagonal(),
              1e-9);
  ASSERT_TRUE(spheres.measure(2.5 / 8, 1'080'000)) << "between two poses";
  for (const float error : spheres.errors) EXPECT_NEAR(error, 1 / 8.0, 1e-6);
}

TEST(Comparisons, OfOneStreamAreZeroBetweenItsPosesToo) {
  TwoSpheres spheres;
  PlayoutSettings settings;
  settings.mode = PlayoutMode::kInterpolate;
  Playout playout(settings);
  for (int f = 0; f < 8; ++f) {
    const TimeUs at_us = 1'000'000 + f * 32'000;
    const ReceivedPose pose = TwoSpheres::pose(spheres.first->asset_, f * f, at_us, at_us);
    for (testing::FakeSource* source : {spheres.first, spheres.second}) source->batches.push_back({pose});
    (void)spheres.both->poll(std::chrono::milliseconds(0));
    playout.add({at_us, pose.coefficients}, at_us);
    const auto shown = playout.at(at_us + 10'000);
    ASSERT_TRUE(shown);
    const std::span<const double> C(shown->coefficients.begin(), shown->coefficients.end());
    ASSERT_TRUE(spheres.both->truth()->errors(C, 3, shown->time_us, spheres.positions, spheres.errors));
    EXPECT_TRUE(shown->settling || spheres.both->truth()->difference()->rms == 0) << f;
  }
}

TEST(Comparisons, AreOfOneArrivalWhereClocksDiffer) {
  TwoSpheres spheres;
  spheres.give(0, 777'000'000, 1'000);
  ASSERT_TRUE(spheres.measure(3 / 8.0, 1'096'000));
  EXPECT_EQ(*std::max_element(spheres.errors.begin(), spheres.errors.end()), 0);
  EXPECT_EQ(spheres.both->truth()->difference()->rms, 0);
}

TEST(Comparisons, OfOtherSurfacesSayWhy) {
  TwoSpheres spheres("another");
  spheres.give(0, 0, 1'000);
  EXPECT_FALSE(spheres.measure(0, 1'000'000));
  EXPECT_FALSE(spheres.both->truth()->why().empty());
  EXPECT_FALSE(spheres.both->truth()->difference());
}

TEST(Comparisons, OfFilesFollowTheTimelineOfTheFirst) {
  const testing::TemporaryFolder folder;
  const auto clip = BakedClip::open(growing_sphere(folder), "").value();
  const auto both = compared(std::make_unique<ClipSource>(clip, 0.05), std::make_unique<ClipSource>(clip));
  std::vector<float> errors(10), positions(30);
  both->timeline()->set_paused(true, steady_now_us());
  both->timeline()->seek(clip->times_us[3], steady_now_us());
  for (int i = 0; i < 3; ++i) (void)both->poll(std::chrono::milliseconds(0));
  ASSERT_TRUE(both->truth()->errors(clip->frames[3], 3, steady_now_us(), positions, errors)) << both->truth()->why();
  EXPECT_LT(*std::max_element(errors.begin(), errors.end()), 1e-6);
}

TEST(ClipSources, UncachedBakeIsReported) {
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("a-file")) << "x";
  const auto clip = BakedClip::open(growing_sphere(folder), folder.file("a-file"));
  ASSERT_TRUE(clip) << clip.error().message;
  const std::string detail = ClipSource(*clip).stats().detail;
  EXPECT_NE(detail.find("a-file"), std::string::npos) << detail;
}

TEST(Connections, TroubledSourceIsNamed) {
  FakeSource first(sphere_asset(1)), second(sphere_asset(1));
  PoseSource* const sources[] = {&first, &second};
  const std::string names[] = {"one", "two"};
  std::vector<LogLevel> logged;
  Connections connections(sources, names, [&](LogLevel level, std::string_view) { logged.push_back(level); });
  first.stats_.keys = 3;
  second.stats_.keys = 4;
  connections.refresh(1'000'000);
  EXPECT_TRUE(connections.are_well());
  EXPECT_EQ(connections.stats().keys, 7u);
  EXPECT_NE(connections.line(false).find("2 of 2"), std::string::npos);
  EXPECT_EQ(connections.banner(0), "");
  second.stats_.state = Subscriber::State::kLost;
  second.stats_.detail = "next try in 400 ms";
  connections.refresh(2'000'000);
  connections.refresh(3'000'000);
  EXPECT_FALSE(connections.are_well());
  EXPECT_EQ(connections.troubled(), 1u);
  EXPECT_FALSE(connections.lost_since_us(0));
  EXPECT_EQ(connections.lost_since_us(1), 2'000'000);
  EXPECT_EQ(connections.stats().keys, 7u);
  EXPECT_NE(connections.line(true).find("1 of 2"), std::string::npos);
  EXPECT_EQ(connections.banner(3'200'000).find("two: "), 0u);
  EXPECT_EQ(logged, (std::vector<LogLevel>{LogLevel::kInfo, LogLevel::kInfo, LogLevel::kWarning})) << "changes only";
  EXPECT_EQ(connections.remove(0), &first);
  EXPECT_EQ(connections.lost_since_us(0), 2'000'000) << "the second has moved up";
  EXPECT_EQ(connections.troubled(), 0u);
}

TEST(OpeningClips, BakeInTheBackground) {
  const testing::TemporaryFolder folder;
  OpeningClip good(growing_sphere(folder), "");
  EXPECT_EQ(good.stats().state, Subscriber::State::kDownloading);
  EXPECT_FALSE(good.stats().detail.empty());
  for (int i = 0; i < 3000 && good.asset() == nullptr; ++i) good.poll(std::chrono::milliseconds(10));
  ASSERT_NE(good.asset(), nullptr);
  EXPECT_EQ(good.stats().state, Subscriber::State::kLive);
  OpeningClip bad("no/such/file.obj", "");
  for (int i = 0; i < 1000 && bad.stats().state != Subscriber::State::kRefused; ++i)
    bad.poll(std::chrono::milliseconds(10));
  EXPECT_EQ(bad.stats().state, Subscriber::State::kRefused);
  EXPECT_NE(bad.stats().detail.find("no/such/file.obj"), std::string::npos);
}

TEST(OpeningClips, WatchedFilesAreReadAgain) {
  const testing::TemporaryFolder folder;
  const std::string file = folder.file("a.obj");
  ASSERT_TRUE(write_surface(make_icosphere(2), file));
  OpeningClip clip(file, "", true);
  const auto until = [&](const std::function<bool()>& there) {
    for (int i = 0; i < 3000 && !there(); ++i) clip.poll(std::chrono::milliseconds(10));
    return there();
  };
  ASSERT_TRUE(until([&] { return clip.asset() != nullptr; }));
  EXPECT_EQ(clip.asset()->vertex_count, 162u);
  EXPECT_EQ(clip.epoch(), 1u);
  ASSERT_TRUE(write_surface(make_icosphere(3), file));
  ASSERT_TRUE(until([&] { return clip.epoch() == 2; })) << "what plays goes on until the new one is there";
  EXPECT_EQ(clip.asset()->vertex_count, 642u);
  EXPECT_EQ(clip.info()->epoch, 2u);
  std::vector<ReceivedPose> poses;
  for (int i = 0; i < 3000 && poses.empty(); ++i) poses = clip.poll(std::chrono::milliseconds(10));
  ASSERT_FALSE(poses.empty());
  EXPECT_EQ(poses.front().envelope.epoch, 2u);
  std::ofstream(file) << "v 1 2\n";
  ASSERT_TRUE(until([&] { return !clip.stats().detail.empty(); }));
  EXPECT_EQ(clip.stats().state, Subscriber::State::kLive) << "the surface as it was stays";
  EXPECT_EQ(clip.asset()->vertex_count, 642u);
  std::filesystem::remove(file);
}

TEST(OpenedLater, TokenGoesToItsBrokerOnly) {
  const std::vector<std::string> streams{"file:heart", "wss://lab:7490/horse", "ws://127.0.0.1:9000/fox"};
  std::vector<Credentials> credentials(3);
  credentials[0].token = "of nobody";
  credentials[1].token = "of the lab";
  credentials[1].ca_file = "lab.pem";
  credentials[2].token = "of this machine";
  const auto token = [&](const std::string& url) { return credentials_for(url, streams, credentials).token; };
  EXPECT_EQ(token("wss://lab:7490/elephant?rate=raw"), "of the lab");
  EXPECT_EQ(token("https://lab:7490/v1/subscribe/elephant"), "of the lab") << "the same broker in other words";
  EXPECT_EQ(token("ws://127.0.0.1:9000/horse"), "of this machine");
  EXPECT_EQ(token("ws://lab:7490/horse"), "") << "never in the clear what was given for TLS";
  EXPECT_EQ(token("wss://lab:7491/horse"), "");
  EXPECT_EQ(token("wss://lab.example.org:7490/horse"), "");
  EXPECT_EQ(token("ws://127.0.0.1:7490/horse"), "");
  EXPECT_EQ(token("file:heart"), "");
  EXPECT_EQ(token("no URL"), "");
  const Credentials own = credentials_for("wss://lab:7490/horse?access_token=mine", streams, credentials);
  EXPECT_EQ(own.token, "") << "the URL's own wins";
  EXPECT_EQ(own.ca_file, "lab.pem");
}

}  // namespace
}  // namespace eigencast
