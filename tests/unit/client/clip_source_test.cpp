// SPDX-License-Identifier: MIT
#include "client/clip_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "client/apps.h"
#include "client/film_plan.h"
#include "client/open_source.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/process.h"
#include "tests/unit/view/fake_source.h"
#include "view/surface_view.h"

namespace eigencast {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::shared_ptr<const BakedClip> baked_heart() {
  static const auto clip = BakedClip::open("heart", "");
  EXPECT_TRUE(clip) << clip.error().message;
  return *clip;
}

TEST(ClipSources, PlayInALoopFromTheirPhase) {
  TimeUs now = 5'000'000;
  const auto clip = baked_heart();
  const double count = static_cast<double>(clip->frames.size());
  ClipSource source(clip, 3 / clip->rate_hz, [&] { return now; });
  auto poses = source.poll({});
  ASSERT_EQ(poses.size(), 1u);
  EXPECT_EQ(poses[0].envelope.capture_us, 5'000'000);
  EXPECT_EQ(poses[0].coefficients, clip->frames[3]);
  EXPECT_TRUE(source.poll({}).empty()) << "the next is not due";
  now += static_cast<TimeUs>(1e6 / clip->rate_hz) + 1;
  EXPECT_EQ(source.poll({}).at(0).coefficients, clip->frames[4]);
  now = 5'000'000 + static_cast<TimeUs>(1e6 * (count - 2) / clip->rate_hz) + 1;
  poses = source.poll({});
  ASSERT_EQ(poses.size(), 1u) << "what was missed is over";
  EXPECT_EQ(poses[0].coefficients, clip->frames[1]) << "the clip begins again";
  EXPECT_EQ(source.stats().keys, 3u);
}

TEST(ClipSources, GiveThePoseOfAnyMoment) {
  TimeUs now = 0;
  const auto clip = baked_heart();
  ClipSource source(clip, 0, [&] { return now; });
  Timeline* timeline = source.timeline();
  ASSERT_NE(timeline, nullptr);
  SceneOptions options;
  options.playout.mode = PlayoutMode::kEstimate;
  SurfaceView view(options);
  const auto shows = [&](const std::vector<double>& C) {
    view.receive(source, source.poll({}));
    testing::advance(view, source, now);
    ASSERT_EQ(view.coefficients().size(), C.size());
    for (std::size_t i = 0; i < C.size(); ++i) EXPECT_NEAR(view.coefficients()[i], C[i], 1e-12);
  };
  shows(clip->frames[0]);
  timeline->set_interpolates(true);
  now += clip->times_us[1] / 2;
  shows(clip->curve().at(now, true));
  now += 1'000'000;
  timeline->seek(clip->times_us[5], now);
  shows(clip->frames[5]);
  timeline->step(-1, now);
  shows(clip->frames[4]);
  now += 1'000'000;
  EXPECT_TRUE(source.poll({}).empty()) << "a pause";
  EXPECT_EQ(view.shown(), Shown::kLive);
}

TEST(ClipSources, PlayedSurfaceIsShown) {
  TimeUs now = 0;
  const auto clip = baked_heart();
  ClipSource source(clip, 0, [&] { return now; });
  SurfaceView view;
  view.receive(source, source.poll({}));
  ASSERT_TRUE(testing::advance(view, source, now));
  EXPECT_EQ(view.poses_shown(), 1u);
  EXPECT_EQ(view.asset_id(), clip->asset_id);
  const auto shape = builtin_clip("heart");
  ASSERT_TRUE(shape);
  const auto truth = (*shape)->pose(0);
  ASSERT_TRUE(truth);
  double worst = 0;
  for (std::size_t i = 0; i < clip->asset.vertex_count; ++i) {
    for (std::size_t d = 0; d < 3; ++d)
      worst = std::max(worst, std::abs(static_cast<double>(view.geometry().positions[3 * i + d]) +
                                       clip->asset.origin[d] - (*truth)[clip->asset.source_vertex[i]][d]));
  }
  EXPECT_LT(worst, 0.02 * clip->asset.diagonal());
}

TEST(ClipSources, MissingTexturesAreWarnedOfOnce) {
  const testing::TemporaryFolder folder;
  const std::string path = folder.file("square.obj");
  std::ofstream(path) << "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl skin\nf 1 2 3 4\n";
  ClientOptions options;
  options.scene.streams = {"file:" + path};
  options.credentials.resize(1);
  options.width = options.height = 64;
  std::vector<std::string> warnings;
  const LogSink log = [&](LogLevel level, std::string_view message) {
    if (level >= LogLevel::kWarning) warnings.emplace_back(message);
  };
  const std::atomic<bool> stop{false};
  const auto warnings_of = [&](bool in_background) {
    warnings.clear();
    const auto source = open_source(options.scene.streams[0], nullptr, options, in_background, stop, log);
    EXPECT_TRUE(source) << source.error().message;
    while (source && (*source)->asset() == nullptr && (*source)->stats().state != Subscriber::State::kRefused)
      (*source)->poll(std::chrono::milliseconds(5));
    return warnings;
  };
  const auto expected = ElementsAre(AllOf(HasSubstr(path), HasSubstr("m.mtl")));
  EXPECT_THAT(warnings_of(false), expected);
  EXPECT_THAT(warnings_of(true), expected);
  warnings.clear();
  options.film = FilmOptions{FilmTarget::from_path(folder.file("p%d.png")).value(), 30, 0.03};
  ASSERT_EQ(run_film(options, stop, log), kExitGood);
  EXPECT_THAT(warnings, expected);
  std::ofstream(folder.file("m.mtl")) << "newmtl skin\nKd 1 0 0\n";
  EXPECT_THAT(warnings_of(false), IsEmpty());
}

TEST(ClipSources, StillFilesGiveOnePose) {
  const auto folder = std::filesystem::temp_directory_path() / ("eigencast-clip-source-" + std::to_string(::getpid()));
  std::filesystem::create_directories(folder);
  const std::string path = (folder / "ball.obj").string();
  ASSERT_TRUE(write_surface(make_icosphere(3), path));
  const auto clip = BakedClip::open(path, (folder / "cache").string());
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->frames.size(), 1u);
  EXPECT_EQ((*clip)->asset.name, "ball");
  const auto again = BakedClip::open(path, (folder / "cache").string());
  ASSERT_TRUE(again);
  EXPECT_EQ((*again)->asset_id, (*clip)->asset_id);
  const auto all = BakedClip::open(folder.string() + "/", (folder / "cache").string());
  ASSERT_TRUE(all) << all.error().message;
  EXPECT_EQ((*all)->name, folder.filename().string());
  std::filesystem::remove_all(folder);
  EXPECT_FALSE(BakedClip::open(path, ""));
  const auto unknown = BakedClip::open("nonsense", "");
  ASSERT_FALSE(unknown);
  EXPECT_NE(unknown.error().message.find("heart"), std::string::npos) << unknown.error().message;
  const auto cancelled = BakedClip::open("bar", "", [](double, std::string_view) { return false; });
  ASSERT_FALSE(cancelled);
  EXPECT_EQ(cancelled.error().code, ErrorCode::kCancelled);
}

}  // namespace
}  // namespace eigencast
