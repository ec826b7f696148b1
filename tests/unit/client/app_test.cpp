// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "client/apps.h"
#include "tests/unit/client/virtual_display.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "tests/unit/view/png.h"
#include "view/picture.h"

namespace eigencast {
namespace {

using nlohmann::json;
using testing::FakeSource;
using testing::sphere_asset;
using testing::sphere_pose;
using testing::VirtualDisplay;

class Apps : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() / ("eigencast-apps-" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
    options_.width = 160;
    options_.height = 120;
    for (int i = 1; i <= 8; ++i) {
      source_.batches.push_back(
          {sphere_pose(source_.asset_, static_cast<std::uint64_t>(i), steady_now_us() + i, 0.5 + 0.05 * i)});
    }
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  LogSink log() {
    return [this](LogLevel level, std::string_view message) {
      said_ += std::string(message) + "\n";
      warnings_ += level >= LogLevel::kWarning ? 1 : 0;
    };
  }

  std::filesystem::path folder_;
  FakeSource source_{sphere_asset(3)};
  const std::vector<PoseSource*> sources_{&source_};
  ClientOptions options_;
  std::atomic<bool> stop_{false};
  std::string said_;
  int warnings_ = 0;
  OpenSource open_ = [](const std::string& stream) -> Result<std::unique_ptr<PoseSource>> {
    return fail(ErrorCode::kNotFound, stream + ": this test opens nothing");
  };
};

TEST_F(Apps, HeadlessWritesPicturesAndReport) {
  options_.headless = true;
  options_.frames = 5;
  options_.out = path("pictures");
  options_.record = path("poses.jsonl");
  options_.hud = true;
  ASSERT_EQ(run_headless(options_, sources_, stop_, log()), kExitGood) << said_;
  Picture before;
  for (int i = 1; i <= 5; ++i) {
    const auto picture = testing::read_png(path("pictures/frame_000" + std::to_string(i) + ".png"));
    ASSERT_TRUE(picture) << picture.error().message;
    EXPECT_EQ(picture->width, 160);
    EXPECT_NE(picture->rgb, before.rgb) << "each picture is of a new pose";
    before = *picture;
  }
  EXPECT_FALSE(std::filesystem::exists(path("pictures/frame_0006.png")));
  std::ifstream in(path("pictures/report.json"));
  const json report = json::parse(in);
  EXPECT_EQ(report["frames_out"]["written"], 5);
  EXPECT_EQ(report["frames_in"]["keys"], 5);
  EXPECT_EQ(report["lod"]["vertices"], 642);
  EXPECT_EQ(report["picture"]["samples"], 4);
  std::ifstream record(path("poses.jsonl"));
  std::string line;
  int lines = 0;
  while (std::getline(record, line)) {
    const json pose = json::parse(line);
    ++lines;
    EXPECT_EQ(pose["sequence"], lines);
    EXPECT_EQ(pose["kind"], "key");
    const auto coefficients = pose["coefficients"].get<std::vector<double>>();
    ASSERT_EQ(coefficients.size(), 18u);
    EXPECT_EQ(coefficients[7], 0.5 + 0.05 * lines) << "to the last bit";
  }
  EXPECT_EQ(lines, 5);
}

TEST_F(Apps, FlightsDrawWithoutNewPoses) {
  std::ofstream(path("flight.json")) << R"({"keys": [{"t": 0, "eye": [0, 0, 5], "target": [0, 0, 0]},
                                                     {"t": 0.3, "eye": [5, 0, 0], "target": [0, 0, 0]}]})";
  options_.headless = true;
  options_.camera_path = path("flight.json");
  options_.json = path("flight-report.json");
  options_.levels.kind = ResolverKind::kBudget;
  FakeSource second(sphere_asset(2));
  const std::vector<PoseSource*> both{&source_, &second};
  ASSERT_EQ(run_headless(options_, both, stop_, log()), kExitGood) << said_;
  const json report = json::parse(std::ifstream(path("flight-report.json")));
  EXPECT_EQ(report["lod"]["resolver"], "budget");
  ASSERT_EQ(report["surfaces"].size(), 2u);
  EXPECT_EQ(report["surfaces"][0]["of"], 642);
  EXPECT_EQ(report["surfaces"][1]["of"], 162);
  EXPECT_EQ(report["frame_time_us"]["work"]["count"], report["frames_out"]["drawn"]);
  EXPECT_EQ(report["frame_time_us"]["decode"]["count"], report["frames_in"]["poses"]);
  EXPECT_GT(report["lod"]["state"], 0);
  options_.camera_path = path("none.json");
  EXPECT_EQ(run_headless(options_, both, stop_, log()), kExitFailed);
}

TEST_F(Apps, GpuAndCpuGiveTheSamePictures) {
  options_.headless = true;
  options_.frames = 3;
  std::map<RebuildOn, Picture> last;
  for (const RebuildOn on : {RebuildOn::kCpu, RebuildOn::kGpu}) {
    FakeSource source(sphere_asset(3));
    for (int i = 1; i <= 3; ++i)
      source.batches.push_back({sphere_pose(source.asset_, static_cast<std::uint64_t>(i), 1000 * i, 0.5 + 0.1 * i)});
    const std::vector<PoseSource*> alone{&source};
    options_.reconstruct = on;
    options_.json = path("rebuilt.json");
    options_.screenshot = path("rebuilt.png");
    ASSERT_EQ(run_headless(options_, alone, stop_, log()), kExitGood) << said_;
    const json report = json::parse(std::ifstream(options_.json));
    EXPECT_EQ(report["reconstruct"]["asked"], kRebuildOnNames[on]);
    EXPECT_EQ(report["reconstruct"]["trial_us"], nullptr);
    EXPECT_EQ(report["surfaces"][0]["rebuilt"], kRebuildOnNames[on]);
    EXPECT_EQ(report["surfaces"][0]["vertices"], 642);
    EXPECT_EQ(report["frame_time_us"]["reconstruct"]["count"], report["frame_time_us"]["normals"]["count"]);
    last[on] = testing::read_png(options_.screenshot).value();
  }
  EXPECT_LT(testing::mean_difference(last[RebuildOn::kCpu], last[RebuildOn::kGpu]), 0.01);
}

TEST_F(Apps, FramesWaitForTheWholeSurface) {
  options_.headless = true;
  options_.frames = 1;
  options_.json = path("whole.json");
  for (const bool first : {false, true}) {
    options_.first = first;
    FakeSource source(sphere_asset(3));
    for (int i = 1; i <= 20; ++i)
      source.batches.push_back({sphere_pose(source.asset_, static_cast<std::uint64_t>(i), 1000 * i, 0.5 + 0.01 * i)});
    source.asset_.rows_ready = 162;
    source.on_poll = [&] {
      if (source.batches.size() == 10) source.asset_.rows_ready = source.asset_.vertex_count;
    };
    const std::vector<PoseSource*> alone{&source};
    ASSERT_EQ(run_headless(options_, alone, stop_, log()), kExitGood) << said_;
    EXPECT_EQ(json::parse(std::ifstream(options_.json))["lod"]["vertices"], first ? 162 : 642);
  }
}

TEST_F(Apps, FramesOfAStalledStreamShowAllOfIt) {
  options_.headless = true;
  options_.frames = 1;
  options_.style.wireframe = true;
  Picture pictures[2];
  for (const bool in_parts : {false, true}) {
    options_.screenshot = path("detail.png");
    FakeSource source(sphere_asset(3));
    source.stats_.state = Subscriber::State::kStalled;
    source.batches.push_back({sphere_pose(source.asset_, 1, 1000, 0.5)});
    if (in_parts) source.asset_.rows_ready = 42;
    int polls = 0;
    source.on_poll = [&] {
      if (++polls == 5) source.asset_.rows_ready = source.asset_.vertex_count;
    };
    const std::vector<PoseSource*> alone{&source};
    ASSERT_EQ(run_headless(options_, alone, stop_, log()), kExitGood) << said_;
    const auto picture = testing::read_png(options_.screenshot);
    ASSERT_TRUE(picture) << picture.error().message;
    pictures[in_parts] = *picture;
  }
  EXPECT_EQ(testing::mean_difference(pictures[0], pictures[1]), 0);
  const auto& pixels = pictures[0].rgb;
  for (std::size_t i = 0; i < pixels.size(); i += 3)
    ASSERT_FALSE(testing::is_clay(&pixels[i])) << "grey, as of a lost stream";
}

TEST_F(Apps, HeadlessWithoutStreamExitsWithFour) {
  source_.has_asset = false;
  source_.batches.clear();
  options_.headless = true;
  options_.wait_s = 0.05;
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitNoStream);
}

TEST_F(Apps, HeadlessNamesTheStreamThatDoesNotCome) {
  FakeSource missing(sphere_asset(1));
  missing.has_asset = false;
  missing.batches.clear();
  missing.stats_.state = Subscriber::State::kWaiting;
  options_.headless = true;
  options_.frames = 1;
  options_.wait_s = 0.05;
  options_.scene.streams = {"ws://a/here", "ws://a/missing"};
  EXPECT_EQ(run_headless(options_, std::vector<PoseSource*>{&source_, &missing}, stop_, log()), kExitNoStream);
  EXPECT_NE(said_.find("no pose came from ws://a/missing"), std::string::npos) << said_;
}

TEST_F(Apps, HeadlessEndsAtOnceWhereASurfaceCannotBeUsed) {
  source_.has_asset = false;
  source_.batches.clear();
  source_.stats_.state = Subscriber::State::kRefused;
  source_.stats_.surface_refused = true;
  options_.headless = true;
  options_.frames = 1;
  options_.wait_s = 1000;
  options_.scene.streams = {"ws://127.0.0.1:1/a"};
  EXPECT_EQ(run_headless(options_, std::vector<PoseSource*>{&source_}, stop_, log()), kExitNoStream) << said_;
}

TEST_F(Apps, HeadlessEndsOnceTheSenderIsGone) {
  options_.headless = true;
  options_.frames = 100;
  options_.wait_s = 0.05;
  options_.json = path("gone.json");
  source_.on_poll = [&] {
    if (source_.batches.empty()) source_.stats_.state = Subscriber::State::kStalled;
  };
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitNoStream) << said_;
  EXPECT_EQ(json::parse(std::ifstream(options_.json))["frames_out"]["drawn"], 8) << "what came is kept";
}

TEST_F(Apps, HeadlessTellsALostBrokerFromALostSender) {
  options_.headless = true;
  options_.frames = 100;
  options_.wait_s = 0.05;
  source_.on_poll = [&] {
    if (source_.batches.empty())
      source_.stats_.state = Subscriber::State::kLost, source_.stats_.detail = "reset by peer";
  };
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitNoStream) << said_;
  EXPECT_NE(said_.find("broker"), std::string::npos) << said_;
  EXPECT_NE(said_.find("reset by peer"), std::string::npos) << said_;
  EXPECT_EQ(said_.find("sender"), std::string::npos) << said_;
}

TEST_F(Apps, HeadlessReportsMissingColours) {
  options_.headless = true;
  options_.frames = 1;
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitGood) << said_;
  EXPECT_EQ(warnings_, 0) << said_;
  options_.style.colour.colouring = Colouring::kOwn;
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitGood) << said_;
  EXPECT_EQ(warnings_, 1) << said_;
}

TEST_F(Apps, FilesThatCannotBeWrittenAreFailures) {
  options_.headless = true;
  options_.record = path("none/poses.jsonl");
  EXPECT_EQ(run_headless(options_, sources_, stop_, log()), kExitFailed);
  EXPECT_NE(said_.find(options_.record), std::string::npos) << said_;
}

TEST_F(Apps, WindowWithoutDisplayIsUnsupported) {
  ::unsetenv("DISPLAY");
  ::unsetenv("WAYLAND_DISPLAY");
  EXPECT_EQ(run_window(options_, sources_, open_, stop_, log()), kExitFailed);
  EXPECT_NE(said_.find("--headless"), std::string::npos) << said_;
}

TEST_F(Apps, WindowWithoutOpenGLIsUnsupported) {
  const VirtualDisplay display("GLX");
  if (!display.ready()) GTEST_SKIP() << "Xvfb does not start: THE WINDOW IS NOT TESTED (install the package xvfb)";
  ::setenv("DISPLAY", display.name().c_str(), 1);
  EXPECT_EQ(run_window(options_, sources_, open_, stop_, log()), kExitFailed);
  EXPECT_NE(said_.find("OpenGL 3.3"), std::string::npos) << said_;
}

/// Pixels that differ in the middle third, where no figures are drawn.
int different_in_the_middle(const Picture& a, const Picture& b) {
  int different = 0;
  for (int y = a.height / 3; y < 2 * a.height / 3; ++y) {
    for (int x = a.width / 3; x < 2 * a.width / 3; ++x) {
      const auto *p = a.pixel(x, y), *q = b.pixel(x, y);
      if (std::abs(p[0] - q[0]) + std::abs(p[1] - q[1]) + std::abs(p[2] - q[2]) > 12) ++different;
    }
  }
  return different;
}

TEST_F(Apps, KeysWheelAndDragReachTheWindow) {
  const VirtualDisplay display;
  if (!display.ready()) GTEST_SKIP() << "Xvfb does not start: INPUT IS NOT TESTED (install the package xvfb)";
  if (std::system("command -v xdotool >/dev/null") != 0)
    GTEST_SKIP() << "xdotool is not there: INPUT IS NOT TESTED (install the package xdotool)";
  ::setenv("DISPLAY", display.name().c_str(), 1);
  options_.width = 480;
  options_.height = 360;
  options_.duration_s = 60;  // only if Q does not end it
  options_.json = path("window.json");
  // Each step is done once the picture of the one before is there; S writes into the current folder.
  const auto start = std::filesystem::current_path();
  std::filesystem::current_path(folder_);
  const std::vector<std::string> steps{
      "mousemove 240 180 key s",
      "key s",
      "mousedown 1 mousemove 300 200 mousemove 340 220 mouseup 1 key s",
      "mousedown 3 mousemove 300 180 mousemove 240 140 mouseup 3 key s",
      "click 4 click 4 click 4 key s",
      "key e key s",
      "key minus key minus key q",
  };
  const auto picture = [&](std::size_t number) { return "eigencast_000" + std::to_string(number) + ".png"; };
  std::size_t done = 0;
  source_.on_poll = [&] {
    const bool ready = done == 0 ? source_.batches.empty() : std::filesystem::exists(picture(done));
    if (!ready || done == steps.size()) return;
    EXPECT_EQ(std::system(("xdotool " + steps[done]).c_str()), 0) << steps[done];
    ++done;
  };
  const int code = run_window(options_, sources_, open_, stop_, log());
  std::vector<Picture> pictures;
  for (std::size_t i = 1; i < steps.size(); ++i) {
    const auto read = testing::read_png(picture(i));
    EXPECT_TRUE(read) << steps[i - 1];
    if (read) pictures.push_back(*read);
  }
  std::filesystem::current_path(start);
  ASSERT_EQ(code, kExitGood) << said_;
  ASSERT_EQ(done, steps.size());
  ASSERT_EQ(pictures.size() + 1, steps.size());
  EXPECT_EQ(different_in_the_middle(pictures[0], pictures[1]), 0) << "nothing was asked for between these";
  for (std::size_t i = 2; i < pictures.size(); ++i)
    EXPECT_GT(different_in_the_middle(pictures[i - 1], pictures[i]), 100) << steps[i];
  const json report = json::parse(std::ifstream(path("window.json")));
  EXPECT_LT(report["lod"]["fraction"], 1) << "minus makes it coarser";
  EXPECT_LT(report["duration_s"], options_.duration_s) << "Q quits";
}

TEST_F(Apps, WindowAndHeadlessShowTheSameSurface) {
  const VirtualDisplay display;
  if (!display.ready()) GTEST_SKIP() << "Xvfb does not start: THE WINDOW IS NOT TESTED (install the package xvfb)";
  ::setenv("DISPLAY", display.name().c_str(), 1);
  options_.width = 480;
  options_.height = 360;
  options_.frames = 3;
  options_.screenshot = path("window.png");
  options_.json = path("window.json");
  ASSERT_EQ(run_window(options_, sources_, open_, stop_, log()), kExitGood) << said_;
  const auto window = testing::read_png(path("window.png"));
  ASSERT_TRUE(window) << window.error().message;

  FakeSource again(sphere_asset(3));
  for (int i = 1; i <= 3; ++i) {
    again.batches.push_back(
        {sphere_pose(again.asset_, static_cast<std::uint64_t>(i), steady_now_us() + i, 0.5 + 0.05 * i)});
  }
  const std::vector<PoseSource*> list_of_again{&again};
  options_.headless = true;
  options_.screenshot = path("headless.png");
  ASSERT_EQ(run_headless(options_, list_of_again, stop_, log()), kExitGood) << said_;
  const auto headless = testing::read_png(path("headless.png"));
  ASSERT_TRUE(headless);
  ASSERT_EQ(window->rgb.size(), headless->rgb.size());
  // The window's has figures over its corners; the middle third is the surface alone.
  int different = 0, seen = 0;
  for (int y = 150; y < 250; ++y) {
    for (int x = 140; x < 340; ++x) {
      ++seen;
      for (int c = 0; c < 3; ++c) {
        if (std::abs(int{window->pixel(x, y)[c]} - int{headless->pixel(x, y)[c]}) > 8) {
          ++different;
          break;
        }
      }
    }
  }
  EXPECT_LT(different, seen / 50);
}

}  // namespace
}  // namespace eigencast
