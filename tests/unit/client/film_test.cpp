// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "client/apps.h"
#include "client/film_plan.h"
#include "client/stream_capture.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "tests/support/process.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "tests/unit/view/png.h"

namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;

TEST(FilmClock, StepsAreConstant) {
  for (const double fps : {24.0, 23.976, 30.0, 60.0, 144.0}) {
    const auto clock = FilmClock::create(100, fps);
    ASSERT_TRUE(clock);
    EXPECT_EQ(clock->pictures(), static_cast<std::uint64_t>(std::round(100 * fps)));
    EXPECT_EQ(clock->time_us(0), 0);
    for (std::uint64_t i = 0; i < clock->pictures(); ++i)
      EXPECT_NEAR(static_cast<double>(clock->time_us(i)), 1e6 * static_cast<double>(i) / fps, 0.5) << "no drift";
  }
  EXPECT_EQ(FilmClock::create(1e-6, 30)->pictures(), 1u);
  EXPECT_EQ(FilmClock::create(1, 60)->time_us(2 * 17), FilmClock::create(1, 30)->time_us(17)) << "of a clip's frame";
}

TEST(FilmClock, RefusesWhatIsNoFilm) {
  for (const double bad : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    EXPECT_EQ(FilmClock::create(bad, 60).error().code, ErrorCode::kInvalidArgument) << bad;
    EXPECT_EQ(FilmClock::create(1, bad).error().code, ErrorCode::kInvalidArgument) << bad;
  }
  EXPECT_EQ(FilmClock::create(1e6, 1000).error().code, ErrorCode::kTooLarge);
}

TEST(FilmTarget, EndingSaysWhatIsWritten) {
  EXPECT_EQ(FilmTarget::from_path("a.mp4")->kind, FilmTarget::Kind::kMp4);
  EXPECT_EQ(FilmTarget::from_path("x/a.webm")->kind, FilmTarget::Kind::kWebm);
  const auto pictures = FilmTarget::from_path("x/f_%04d.png");
  ASSERT_TRUE(pictures);
  EXPECT_EQ(pictures->picture_path(7), "x/f_0007.png");
  EXPECT_EQ(pictures->picture_path(123'456), "x/f_123456.png");
  EXPECT_EQ(FilmTarget::from_path("f%d.png")->picture_path(7), "f7.png");
  for (const char* bad : {"", "a", "a.avi", ".mp4", "x/.webm", "a.png", "%s.png", "%d%d.png", "%04x.png", "%0d.png",
                          "%n.png", "%.png", "%%d.png", "%-4d.png", "%04d.mp4.png%"})
    EXPECT_FALSE(FilmTarget::from_path(bad)) << bad;
}

/// Pose k is k^2 in its first entry and (k - 3)^2 in its second.
std::vector<std::vector<double>> parabola(int count) {
  std::vector<std::vector<double>> frames;
  for (double k = 0; k < count; ++k) frames.push_back({k * k, (k - 3) * (k - 3)});
  return frames;
}

TEST(ClipMotion, IsExactForParabolasAndAtFrames) {
  const auto frames = parabola(6);
  const std::vector<TimeUs> times{0, 100'000, 200'000, 300'000, 400'000, 500'000};
  const ClipMotion motion{frames, times, 600'000, false};
  for (std::size_t i = 0; i < frames.size(); ++i) EXPECT_EQ(motion.at(times[i], true), frames[i]) << "to the bit";
  for (TimeUs t = 0; t <= 500'000; t += 12'345) {
    const double k = static_cast<double>(t) / 1e5;
    EXPECT_NEAR(motion.at(t, true)[0], k * k, 1e-9) << t;
    EXPECT_NEAR(motion.at(t, true)[1], (k - 3) * (k - 3), 1e-9) << t;
  }
  EXPECT_EQ(motion.at(599'999, true), frames[5]) << "no way back from the end of what is not a cycle";
}

TEST(ClipMotion, CyclesGoOnAcrossTheSeam) {
  std::vector<std::vector<double>> frames;
  std::vector<TimeUs> times;
  for (int k = 0; k < 40; ++k) {
    frames.push_back({std::cos(0.05 * M_PI * k), std::sin(0.05 * M_PI * k)});
    times.push_back(k * 10'000);
  }
  ASSERT_TRUE(ends_where_it_begins(frames));
  const ClipMotion motion{frames, times, 400'000, true};
  for (TimeUs t = 380'000; t < 400'000; t += 777) {
    EXPECT_NEAR(motion.at(t, true)[0], std::cos(5e-6 * M_PI * static_cast<double>(t)), 1e-4) << t;
    EXPECT_NEAR(motion.at(t, true)[1], std::sin(5e-6 * M_PI * static_cast<double>(t)), 1e-4) << t;
  }
  EXPECT_EQ(motion.at(395'000, false), frames.back());
  EXPECT_FALSE(ends_where_it_begins(parabola(6)));
  EXPECT_FALSE(ends_where_it_begins(parabola(1)));
}

TEST(StreamCaptures, KeepThePosesOfAStream) {
  FakeSource source(sphere_asset(1));
  const auto pose = [&](std::uint64_t k) {
    return sphere_pose(source.asset_, k, 1'000'000 + 1000 * static_cast<TimeUs>(k), 0.5, static_cast<double>(k));
  };
  ReceivedPose estimate = pose(4);
  estimate.envelope.kind = FrameKind::kEstimate;
  source.asset_.rows_ready = 12;
  source.batches = {{pose(1)}, {pose(2), pose(3)}, {estimate, pose(5), pose(5)}, {pose(7)}};
  StreamCapture capture(source);
  ASSERT_TRUE(capture.take({}));
  EXPECT_TRUE(capture.is_empty()) << "half a surface is no picture of a film";
  source.asset_.rows_ready = source.asset_.vertex_count;
  ASSERT_TRUE(capture.take({}));
  capture.begin();
  EXPECT_EQ(capture.length_us(), 0);
  ASSERT_TRUE(capture.take({}));
  ASSERT_TRUE(capture.take({}));
  EXPECT_EQ(capture.length_us(), 4000);
  EXPECT_FALSE(capture.is_lost());
  source.stats_.state = Subscriber::State::kStalled;
  EXPECT_TRUE(capture.is_lost());
  const auto clip = capture.clip();
  EXPECT_EQ(clip->times_us, (std::vector<TimeUs>{0, 2000, 4000}));
  ASSERT_EQ(clip->frames.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(clip->frames[i][0], static_cast<double>(3 + 2 * i));
  for (TimeUs t = 0; t <= 4000; t += 250)
    EXPECT_NEAR(clip->curve().at(t, true)[0], 3 + static_cast<double>(t) / 1000, 1e-9) << "as evenly as it was sent";
  EXPECT_EQ(clip->info->stream, "demo");
  EXPECT_EQ(clip->asset.vertex_count, source.asset_.vertex_count);
}

TEST(StreamCaptures, ASenderMayComeBackWithTheSameSurface) {
  FakeSource source(sphere_asset(1));
  source.info_->asset = "one";
  source.info_->epoch = 1;
  source.batches = {{sphere_pose(source.asset_, 1, 1000, 1)},
                    {sphere_pose(source.asset_, 2, 2000, 2)},
                    {sphere_pose(source.asset_, 3, 3000, 3)}};
  StreamCapture capture(source);
  ASSERT_TRUE(capture.take({}));
  source.info_->epoch = source.epoch_ = 2;
  ASSERT_TRUE(capture.take({}));
  EXPECT_EQ(capture.length_us(), 1000);
  source.info_->epoch = source.epoch_ = 3;
  source.info_->asset = "another";
  source.asset_ = sphere_asset(2);
  EXPECT_EQ(capture.take({}).error().code, ErrorCode::kUnsupported);
}

TEST(StreamCaptures, ASenderMayGoOnInAnotherBasis) {
  FakeSource source(sphere_asset(1));
  source.info_->asset = "one";
  source.info_->epoch = 1;
  source.batches = {{sphere_pose(source.asset_, 1, 1000, 1.5)}, {sphere_pose(source.asset_, 2, 2000, 2)}};
  StreamCapture capture(source);
  ASSERT_TRUE(capture.take({}));
  source.info_->asset = "another";
  source.info_->epoch = source.epoch_ = 2;
  ASSERT_TRUE(capture.take({}));
  const auto clip = capture.clip();
  EXPECT_EQ(clip->asset_id, "another");
  ASSERT_EQ(clip->frames.size(), 2U);
  EXPECT_NEAR(clip->frames[0][7], 1.5, 1e-9) << "in the last basis";
}

TEST(StreamCaptures, APastIsKeptFromItsBeginningToItsEnd) {
  FakeSource source(sphere_asset(1));
  source.info_->asset = "one";
  source.info_->epoch = 1;
  source.info_->utc_us = 500;
  source.batches = {{sphere_pose(source.asset_, 1, 9'000, 1)},
                    {sphere_pose(source.asset_, 1, 1'000, 1)},
                    {sphere_pose(source.asset_, 2, 3'000, 2)},
                    {sphere_pose(source.asset_, 9, 99'000, 1)}};
  StreamCapture capture(source);
  ASSERT_TRUE(capture.take({}));
  source.info_->rewind = control::StreamInfo::Rewind{0, 1'000, 0.5};
  source.info_->epoch = source.epoch_ = 2;
  ASSERT_TRUE(capture.take({}));
  EXPECT_EQ(capture.length_us(), 0) << "what was live is forgotten";
  ASSERT_TRUE(capture.take({}));
  EXPECT_FALSE(capture.is_lost());
  source.info_->rewind.reset();
  source.info_->epoch = source.epoch_ = 3;
  ASSERT_TRUE(capture.take({}));
  EXPECT_TRUE(capture.is_lost()) << "it is live again";
  const auto clip = capture.clip();
  EXPECT_EQ(clip->times_us, (std::vector<TimeUs>{0, 2'000}));
  EXPECT_EQ(clip->utc_us, (std::vector<TimeUs>{1'500, 2'500}));
}

/// Films of a ball that moves to the right by the same way from each of its twelve frames to the next.
class Films : public ::testing::Test {
 protected:
  static constexpr int kFrames = 12;

  void SetUp() override {
    Surface ball = make_icosphere(2);
    for (int k = 0; k < kFrames; ++k) {
      EXPECT_TRUE(write_surface(ball, folder_.file("f" + std::to_string(10 + k) + ".obj")));
      for (Vec3& p : ball.positions) p[0] += 0.1;
    }
    options_.scene.streams = {"file:" + folder_.file("f*.obj")};
    options_.credentials.resize(1);
    options_.headless = true;
    options_.width = 320;
    options_.height = 180;
    options_.view = "front";
    options_.json = folder_.file("report.json");
  }

  int film(const std::string& name, double fps) {
    options_.film = FilmOptions{FilmTarget::from_path(folder_.file(name)).value(), fps, 0};
    return run_film(options_, stop_,
                    [this](LogLevel, std::string_view message) { said_ += std::string(message) + "\n"; });
  }
  std::vector<Picture> pictures(const std::string& prefix) const {
    std::vector<Picture> all;
    for (int i = 1; std::filesystem::exists(folder_.file(prefix + std::to_string(i) + ".png")); ++i)
      all.push_back(testing::read_png(folder_.file(prefix + std::to_string(i) + ".png")).value());
    return all;
  }
  /// The mean column of the ball's pixels.
  static double column_of(const Picture& picture) {
    double sum = 0, count = 0;
    for (int y = 0; y < picture.height; ++y) {
      for (int x = 0; x < picture.width; ++x) {
        if (!testing::is_clay(picture.pixel(x, y))) continue;
        sum += x;
        ++count;
      }
    }
    return sum / count;
  }

  const testing::TemporaryFolder folder_;
  ClientOptions options_;
  std::atomic<bool> stop_{false};
  std::string said_;
};

TEST_F(Films, ShowEveryPoseOnceInConstantSteps) {
  for (const int per_frame : {1, 2}) {
    const std::string prefix = "p" + std::to_string(per_frame) + "_";
    ASSERT_EQ(film(prefix + "%d.png", 30.0 * per_frame), kExitGood) << said_;
    const std::vector<Picture> all = pictures(prefix);
    ASSERT_EQ(all.size(), static_cast<std::size_t>(kFrames * per_frame));
    const double first = column_of(all.front());
    const double step =
        (column_of(all[static_cast<std::size_t>((kFrames - 1) * per_frame)]) - first) / ((kFrames - 1) * per_frame);
    EXPECT_GT(step, 4.0 / per_frame) << "else a pose is not told from its neighbour";
    for (int i = 0; i < kFrames * per_frame; ++i) {
      const int shown = std::min(i, (kFrames - 1) * per_frame);  // the last frame stays until the clip begins again
      EXPECT_NEAR(column_of(all[static_cast<std::size_t>(i)]), first + shown * step, 0.4 * step) << i;
    }
  }
  const auto report = nlohmann::json::parse(std::ifstream(options_.json));
  EXPECT_EQ(report["frames_out"]["written"], 2 * kFrames);
}

TEST_F(Films, AreTheSameToTheBit) {
  options_.turntable_s = 0.4;
  options_.style.colour.colouring = Colouring::kMovement;
  options_.hud = true;  // the legend
  for (const char* name : {"a_%d.png", "b_%d.png"}) ASSERT_EQ(film(name, 60), kExitGood) << said_;
  const auto a = pictures("a_"), b = pictures("b_");
  ASSERT_EQ(a.size(), 24u) << "one turn";
  ASSERT_EQ(b.size(), a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].rgb, b[i].rgb) << i;
    EXPECT_NE(a[i].rgb, a[(i + 1) % a.size()].rgb) << i;
  }
}

TEST_F(Films, EveryPictureHasItsLegend) {
  options_.style.colour.colouring = Colouring::kMovement;
  options_.hud = true;
  ASSERT_EQ(film("with_%d.png", 30), kExitGood) << said_;
  options_.hud = false;
  ASSERT_EQ(film("without_%d.png", 30), kExitGood) << said_;
  const auto with = pictures("with_"), without = pictures("without_");
  ASSERT_EQ(with.size(), without.size());
  for (std::size_t i = 0; i < with.size(); ++i) {
    const int x = options_.width - 16, y = options_.height - 16;
    EXPECT_LT(with[i].pixel(x, y)[0], without[i].pixel(x, y)[0] - 40) << i;
  }
}

TEST_F(Films, AColourMeansTheSameInEveryPicture) {
  for (const Colouring numbers : {Colouring::kMovement, Colouring::kSpeed}) {
    options_.style.colour.colouring = numbers;
    options_.style.colour_range.reset();
    const std::string prefix = "n" + std::to_string(static_cast<int>(numbers)) + "_";
    ASSERT_EQ(film(prefix + "%d.png", 30), kExitGood) << said_;
    // The ball moves 1.1 units, by 3 a second: what clips have shown all along.
    options_.style.colour_range = numbers == Colouring::kMovement ? std::array{0.0F, 1.5F} : std::array{0.0F, 4.0F};
    ASSERT_EQ(film(prefix + "given_%d.png", 30), kExitGood) << said_;
    const auto found = pictures(prefix), given = pictures(prefix + "given_");
    ASSERT_EQ(found.size(), static_cast<std::size_t>(kFrames));
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_EQ(found[i].rgb, given.at(i).rgb) << i;
  }
}

TEST_F(Films, FollowTheCameraPath) {
  options_.camera_path = folder_.file("flight.json");
  std::ofstream(options_.camera_path) << R"({"keys": [{"t": 0, "eye": [0, 0, 6], "target": [0, 0, 0]},
                                                      {"t": 0.5, "eye": [2, 0, 6], "target": [2, 0, 0]}]})";
  for (const char* name : {"a_%d.png", "b_%d.png"}) ASSERT_EQ(film(name, 24), kExitGood) << said_;
  const auto a = pictures("a_"), b = pictures("b_");
  ASSERT_EQ(a.size(), 12u) << "as long as the path";
  ASSERT_EQ(b.size(), a.size());
  for (std::size_t i = 0; i < a.size(); ++i) EXPECT_EQ(a[i].rgb, b[i].rgb) << i;
  EXPECT_LT(column_of(a.back()), column_of(a.front()) - 20) << "the camera is quicker than the ball";
}

TEST_F(Films, VideosHoldEveryPicture) {
  if (!testing::on_path("ffmpeg"))
    GTEST_SKIP() << "ffmpeg is not there: VIDEOS ARE NOT TESTED (install the package ffmpeg)";
  for (const char* name : {"film.mp4", "film.webm"}) {
    ASSERT_EQ(film(name, 60), kExitGood) << said_;
    const std::string frames = folder_.file("frames.txt");
    ASSERT_EQ(std::system(("ffprobe -v error -count_frames -show_entries stream=nb_read_frames -of csv=p=0 " +
                           folder_.file(name) + " > " + frames)
                              .c_str()),
              0);
    int count = 0;
    std::ifstream(frames) >> count;
    EXPECT_EQ(count, 2 * kFrames) << name;
    EXPECT_FALSE(std::filesystem::exists(folder_.file(name) + ".partial"));
  }
}

TEST_F(Films, FailuresLeaveNothingBehind) {
  EXPECT_EQ(film("none/film.mp4", 60), kExitFailed);
  std::ofstream(folder_.file("file")) << "x";
  EXPECT_EQ(film("file/%d.png", 60), kExitFailed) << "no folder can be made there";
  options_.width = 321;
  EXPECT_EQ(film("odd.mp4", 60), kExitFailed);
  options_.width = 320;
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", "/nonexistent", 1);
  EXPECT_EQ(film("film.mp4", 60), kExitFailed);
  EXPECT_NE(said_.find("frame_%04d.png"), std::string::npos) << "the other way: " << said_;
  // An ffmpeg that dies at once.
  std::ofstream(folder_.file("ffmpeg")) << "#!/bin/sh\necho no such encoder >&2\nexit 3\n";
  std::filesystem::permissions(folder_.file("ffmpeg"), std::filesystem::perms::owner_all);
  ::setenv("PATH", folder_.path().c_str(), 1);
  EXPECT_EQ(film("film.mp4", 60), kExitFailed);
  EXPECT_NE(said_.find("no such encoder"), std::string::npos) << said_;
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_FALSE(std::filesystem::exists(folder_.file("film.mp4")));
  EXPECT_FALSE(std::filesystem::exists(folder_.file("film.mp4.partial")));
  EXPECT_FALSE(std::filesystem::exists(folder_.file("odd.mp4")));
}

TEST_F(Films, StoppedBeforeTheFirstPictureIsNoFilm) {
  stop_.store(true);
  EXPECT_EQ(film("film_%d.png", 60), kExitStopped);
  EXPECT_TRUE(pictures("film_").empty());
}

TEST_F(Films, StoppedEarlyIsToldFromAWholeOne) {
  options_.film = FilmOptions{FilmTarget::from_path(folder_.file("new/film_%d.png")).value(), 60, 1000};
  std::thread stopper([&] {
    while (!std::filesystem::exists(folder_.file("new/film_3.png")))
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    stop_.store(true);
  });
  EXPECT_EQ(run_film(options_, stop_, {}), kExitStopped);
  stopper.join();
  EXPECT_GE(pictures("new/film_").size(), 3u) << "what was drawn is there, in a folder that was made";
}

}  // namespace
}  // namespace eigencast
