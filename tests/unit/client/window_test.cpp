// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "client/apps.h"
#include "client/clip_source.h"
#include "client/settings.h"
#include "tests/support/process.h"
#include "tests/unit/client/drop_source.h"
#include "tests/unit/client/virtual_display.h"
#include "tests/unit/view/fake_source.h"
#include "tests/unit/view/offscreen_pictures.h"
#include "tests/unit/view/png.h"
#include "view/picture.h"

// The window as a user meets it: real X events through a virtual display.
namespace eigencast {
namespace {

using testing::FakeSource;
using testing::sphere_asset;
using testing::VirtualDisplay;

class TheWindow : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!display_.ready()) GTEST_SKIP() << "Xvfb does not start: THE WINDOW IS NOT TESTED (install the package xvfb)";
    if (std::system("command -v xdotool >/dev/null") != 0)
      GTEST_SKIP() << "xdotool is not there: THE WINDOW IS NOT TESTED (install the package xdotool)";
    ::setenv("DISPLAY", display_.name().c_str(), 1);
    options_.width = 640;
    options_.height = 480;
    options_.size_given = true;
    options_.duration_s = 60;  // only if nothing else ends it
    options_.settings = folder_.file("config/viewer.json");
  }

  /// Opens what the user asks for as a still sphere, and notes what that was.
  OpenSource opener() {
    return [this](const std::string& stream) -> Result<std::unique_ptr<PoseSource>> {
      const std::lock_guard lock(mutex_);
      opened_.push_back(stream);
      if (stream.find("nowhere") != std::string::npos) return fail(ErrorCode::kNotFound, stream + ": no such file");
      return std::unique_ptr<PoseSource>(std::make_unique<FakeSource>(sphere_asset(2)));
    };
  }
  std::vector<std::string> opened() {
    const std::lock_guard lock(mutex_);
    return opened_;
  }
  static bool xdotool(const std::string& command) { return std::system(("xdotool " + command).c_str()) == 0; }

  /// Runs the window while `user` does things; ends it afterwards.
  int run(const std::function<void()>& user) {
    std::thread thread([&] {
      for (int i = 0; i < 500 && !xdotool("search --onlyvisible --name Eigencast >/dev/null 2>&1"); ++i)
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      user();
      stop_.store(true);
    });
    const int code = run_window(options_, {}, opener(), stop_, [this](LogLevel, std::string_view message) {
      const std::lock_guard lock(mutex_);
      said_ += std::string(message) + "\n";
    });
    thread.join();
    return code;
  }
  bool said(const std::string& what) {
    const std::lock_guard lock(mutex_);
    return said_.find(what) != std::string::npos;
  }
  static bool until(const std::function<bool()>& there) {
    for (int i = 0; i < 12'000 && !there(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return there();
  }

  const VirtualDisplay display_;
  const testing::TemporaryFolder folder_;
  ClientOptions options_;
  std::atomic<bool> stop_{false};
  std::mutex mutex_;
  std::vector<std::string> opened_;
  std::string said_;
};

TEST_F(TheWindow, WelcomeOpensADemo) {
  EXPECT_EQ(run([&] {
              // Down the buttons, wherever the fonts put them, until one is hit.
              for (int i = 0; i < 25 * 40 && opened().empty(); ++i) {
                xdotool("mousemove 200 " + std::to_string(100 + 8 * (i % 25)) + " click 1");
                std::this_thread::sleep_for(std::chrono::milliseconds(120));
              }
            }),
            kExitGood);
  ASSERT_FALSE(opened().empty());
  const std::string demo = opened().front();
  ASSERT_TRUE(demo.starts_with("file:")) << demo;
  const auto settings = Settings::load(options_.settings);
  ASSERT_TRUE(settings);
  EXPECT_EQ(settings->recent, (std::vector<std::string>{demo.substr(5)})) << "remembered for the next time";
}

TEST_F(TheWindow, OpensDroppedStreamsAndFiles) {
  EXPECT_EQ(
      run([&] {
        EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a%20mesh.obj\r\n"));
        EXPECT_TRUE(until([&] { return opened().size() == 1; }));
        EXPECT_TRUE(testing::drop_on_window(display_.name(), "ws://127.0.0.1:7490/live/heart?access_token=secret\r\n"));
        EXPECT_TRUE(until([&] { return opened().size() == 2; }));
        EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///nowhere.obj\r\n"));
        EXPECT_TRUE(until([&] { return said("no such file"); }));
      }),
      kExitGood);
  ASSERT_GE(opened().size(), 2u);
  EXPECT_EQ(opened()[0], "file:/tmp/a mesh.obj");
  EXPECT_EQ(opened()[1], "ws://127.0.0.1:7490/live/heart?access_token=secret");
  std::ifstream in(options_.settings);
  const std::string remembered((std::istreambuf_iterator<char>(in)), {});
  EXPECT_NE(remembered.find("live/heart"), std::string::npos) << remembered;
  EXPECT_EQ(remembered.find("secret"), std::string::npos) << "tokens are nobody's business";
}

TEST_F(TheWindow, StyleIsRememberedByTheNextWindow) {
  const auto start = std::filesystem::current_path();
  std::filesystem::current_path(folder_.path());
  EXPECT_EQ(run([&] {
              EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
              EXPECT_TRUE(until([&] { return opened().size() == 1; }));
              xdotool("mousemove 320 300 key w key c key Tab key shift+s");
              EXPECT_TRUE(until([&] { return std::filesystem::exists("eigencast_0001.png"); }));
              xdotool("key ctrl+c mousedown 1 mousemove 420 330 mouseup 1 key ctrl+v key shift+s");
              EXPECT_TRUE(until([&] { return std::filesystem::exists("eigencast_0002.png"); }));
              xdotool("key a key m key shift+s");
              EXPECT_TRUE(until([&] { return std::filesystem::exists("eigencast_0003.png"); }));
            }),
            kExitGood);
  const auto first = testing::read_png("eigencast_0001.png"), second = testing::read_png("eigencast_0002.png");
  std::filesystem::current_path(start);
  ASSERT_TRUE(first);
  ASSERT_TRUE(second);
  double difference = 0;
  ASSERT_EQ(first->rgb.size(), second->rgb.size());
  for (std::size_t i = 0; i < first->rgb.size(); ++i) difference += std::abs(first->rgb[i] - second->rgb[i]);
  EXPECT_LT(difference / static_cast<double>(first->rgb.size()), 0.5) << "the camera came back from the clipboard";
  const auto settings = Settings::load(options_.settings);
  ASSERT_TRUE(settings);
  EXPECT_TRUE(settings->style.wireframe);
  EXPECT_TRUE(settings->panel);
  EXPECT_EQ(settings->style.colour_map, ColourMap::kCividis);
  EXPECT_EQ(settings->resolver, ResolverKind::kBudget);
  EXPECT_EQ(settings->playout, PlayoutMode::kInterpolate);
  for (const bool given : {false, true}) {
    stop_.store(false);
    options_.resolver_given = options_.playout_given = given;
    options_.json = folder_.file("report.json");
    EXPECT_EQ(run([&] {
                EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
                EXPECT_TRUE(until([&] { return opened().size() == (given ? 3u : 2u); }));
              }),
              kExitGood);
    const auto report = nlohmann::json::parse(std::ifstream(options_.json));
    EXPECT_EQ(report["lod"]["resolver"], given ? "none" : "budget") << "the command line says more than memory";
    EXPECT_EQ(report["playout"]["mode"], given ? "latest" : "interpolate");
  }
}

// windowclose destroys the window alone, windowkill takes the program's connection to the display away (xkill).
TEST_F(TheWindow, EndsInOrderWhenAnotherProgramTakesItAway) {
  for (const char* way : {"windowclose", "windowkill"}) {
    stop_.store(false);
    said_.clear();
    EXPECT_EQ(run([&] {
                EXPECT_TRUE(xdotool(std::string("search --onlyvisible --name Eigencast ") + way));
                EXPECT_TRUE(until([&] { return said("the window is gone"); })) << way;
              }),
              kExitFailed)
        << way;
  }
}

TEST_F(TheWindow, DrawsOnlyWhenSomethingHasChanged) {
  options_.width = 200;
  options_.height = 150;
  options_.settings = "";
  options_.json = folder_.file("report.json");
  EXPECT_EQ(run([&] {
              EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
              std::this_thread::sleep_for(std::chrono::seconds(2));
            }),
            kExitGood);
  const auto report = nlohmann::json::parse(std::ifstream(options_.json));
  EXPECT_GE(report["frames_out"]["drawn"], 3);
  EXPECT_LE(report["frames_out"]["drawn"], 60) << "figures change four times a second, and the surface does not move";
}

/// The picture of key S.
Picture screenshot(const std::string& keys, const std::string& name) {
  EXPECT_EQ(std::system(("xdotool mousemove 320 300 key " + keys + " key s").c_str()), 0);
  for (int i = 0; i < 1000 && !std::filesystem::exists(name); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  const auto picture = testing::read_png(name);
  return picture ? *picture : Picture{};
}

TEST_F(TheWindow, TurntableTurns) {
  options_.settings = "";
  options_.turntable_s = 8;
  const auto start = std::filesystem::current_path();
  std::filesystem::current_path(folder_.path());
  Picture first, second;
  EXPECT_EQ(run([&] {
              EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
              EXPECT_TRUE(until([&] { return opened().size() == 1; }));
              first = screenshot("f", "eigencast_0001.png");
              second = screenshot("y", "eigencast_0002.png");
            }),
            kExitGood);
  std::filesystem::current_path(start);
  ASSERT_EQ(first.rgb.size(), 3u * 640 * 480);
  ASSERT_EQ(second.rgb.size(), first.rgb.size());
  EXPECT_GT(testing::mean_difference(first, second), 0.2) << "the floor's grid turns with the scene";
}

TEST_F(TheWindow, CameraPathsMoveTheView) {
  options_.settings = "";
  options_.camera_path = folder_.file("flight.json");
  std::ofstream(options_.camera_path) << R"({"keys": [{"t": 0, "eye": [0, 0, 5], "target": [0, 0, 0]},
                                                      {"t": 8, "eye": [5, 0, 0], "target": [0, 0, 0]}]})";
  const auto start = std::filesystem::current_path();
  std::filesystem::current_path(folder_.path());
  Picture first, second;
  EXPECT_EQ(run([&] {
              EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
              EXPECT_TRUE(until([&] { return opened().size() == 1; }));
              first = screenshot("f", "eigencast_0001.png");
              second = screenshot("f", "eigencast_0002.png");
            }),
            kExitGood);
  std::filesystem::current_path(start);
  ASSERT_EQ(first.rgb.size(), 3u * 640 * 480);
  ASSERT_EQ(second.rgb.size(), first.rgb.size());
  EXPECT_GT(testing::mean_difference(first, second), 0.2);
}

/// Plays a clip and says which of its frames it gave last.
class ObservedClip final : public PoseSource {
 public:
  /// busy: the window waits while it is locked.
  ObservedClip(std::shared_ptr<const BakedClip> clip, std::atomic<double>& frame, std::mutex& busy)
      : clip_(std::move(clip)), frame_(frame), busy_(busy) {}
  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override {
    const std::lock_guard lock(busy_);
    std::vector<ReceivedPose> poses = clip_.poll(timeout);
    if (!poses.empty()) frame_.store(poses.back().coefficients[0]);
    return poses;
  }
  const Asset* asset() const override { return clip_.asset(); }
  std::uint32_t epoch() const override { return clip_.epoch(); }
  const std::optional<control::StreamInfo>& info() const override { return clip_.info(); }
  Subscriber::Stats stats() const override { return clip_.stats(); }
  Timeline* timeline() const override { return clip_.timeline(); }

 private:
  ClipSource clip_;
  std::atomic<double>& frame_;
  std::mutex& busy_;
};

TEST_F(TheWindow, TimelineIsDraggedAndStepped) {
  constexpr int kLast = 600;
  auto clip = std::make_shared<BakedClip>();
  clip->asset = sphere_asset(1);
  for (int k = 0; k <= kLast; ++k) {
    clip->frames.emplace_back(clip->asset.rest.begin(), clip->asset.rest.end());
    clip->frames.back()[0] = k;
    clip->times_us.push_back(100'000 * k);
  }
  clip->period_us = 100'000 * (kLast + 1);
  options_.settings = "";
  std::atomic<double> frame{-1};
  std::mutex busy;
  const OpenSource open = [&](const std::string&) -> Result<std::unique_ptr<PoseSource>> {
    return std::unique_ptr<PoseSource>(std::make_unique<ObservedClip>(clip, frame, busy));
  };
  double dragged_to = -1, stepped_to = -1, ended_at = -1;
  Picture before, after;
  const auto start = std::filesystem::current_path();
  std::filesystem::current_path(folder_.path());
  std::thread user([&] {
    EXPECT_TRUE(until([&] { return xdotool("search --onlyvisible --name Eigencast >/dev/null 2>&1"); }));
    EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
    EXPECT_TRUE(until([&] { return frame >= 1; })) << "it plays";
    xdotool("mousemove 320 200 key space");
    // The bar is at the bottom in the middle. ImGui looks at the mouse once a picture.
    EXPECT_TRUE(until([&] {
      for (const char* step :
           {"mousemove 300 455", "mousedown 1", "mousemove 420 455", "mousemove 350 455", "mouseup 1"}) {
        xdotool(step);
        std::this_thread::sleep_for(std::chrono::milliseconds(150));
      }
      return frame > 100;
    }));
    dragged_to = frame;
    xdotool("mousemove 320 200 key comma");
    EXPECT_TRUE(until([&] { return frame != dragged_to; }));
    stepped_to = frame;
    xdotool("key End");
    EXPECT_TRUE(until([&] { return frame == kLast; }));
    ended_at = frame;
    before = screenshot("f", "eigencast_0001.png");  // which hides the bar
    xdotool("key f");
    std::this_thread::sleep_for(std::chrono::seconds(4));  // the notice of the picture goes
    {
      // Between two pictures the mouse comes to the bar, presses, and goes far to the upper left.
      const std::lock_guard lock(busy);
      xdotool("mousemove 300 455 mousedown 1 mousemove 100 120");
    }
    EXPECT_TRUE(until([&] { return frame == 0; })) << "the bar is dragged to its beginning";
    xdotool("mouseup 1 key End");
    EXPECT_TRUE(until([&] { return frame == kLast; }));
    after = screenshot("f", "eigencast_0002.png");
    stop_.store(true);
  });
  EXPECT_EQ(run_window(options_, {}, open, stop_, [](LogLevel, std::string_view) {}), kExitGood);
  user.join();
  std::filesystem::current_path(start);
  ASSERT_EQ(before.rgb.size(), after.rgb.size());
  EXPECT_LT(testing::mean_difference(before, after), 0.5) << "the scene has not turned";
  EXPECT_EQ(stepped_to, dragged_to - 1);
  EXPECT_EQ(ended_at, kLast);
}

TEST_F(TheWindow, TextsAndLinesFollowTheDisplay) {
  options_.width = 720;
  options_.height = 560;
  options_.settings = "";
  options_.style_given = options_.style.wireframe = true;
  const auto start = std::filesystem::current_path();
  std::map<int, double> box, lines;
  for (const int dpi : {96, 192}) {
    ASSERT_TRUE(testing::set_display_density(display_.name(), dpi));
    const std::string folder = folder_.file(std::to_string(dpi));
    std::filesystem::create_directories(folder);
    std::filesystem::current_path(folder);
    stop_.store(false);
    Picture picture;
    EXPECT_EQ(run([&] {
                EXPECT_TRUE(testing::drop_on_window(display_.name(), "file:///tmp/a.obj\r\n"));
                std::this_thread::sleep_for(std::chrono::milliseconds(500));
                picture = screenshot("f", "eigencast_0001.png");
              }),
              kExitGood);
    std::filesystem::current_path(start);
    ASSERT_EQ(picture.rgb.size(), 3u * 720 * 560);
    // The box of the connection is dark on a light floor, and as wide there as its padding; the lines are of clay.
    for (int y = 400; y < 560; ++y) box[dpi] += picture.pixel(16 * dpi / 96, y)[0] < 110 ? 1 : 0;
    for (int y = 0; y < 560; ++y) {
      for (int x = 0; x < 720; ++x) lines[dpi] += testing::is_clay(picture.pixel(x, y)) ? 1 : 0;
    }
  }
  EXPECT_NEAR(box[96], 31, 4);
  EXPECT_NEAR(box[192] / box[96], 2, 0.2);
  EXPECT_GT(lines[96], 1000);
  EXPECT_GT(lines[192], 1.4 * lines[96]);
}

}  // namespace
}  // namespace eigencast
