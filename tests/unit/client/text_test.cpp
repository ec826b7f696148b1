// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "client/hud_text.h"
#include "client/options.h"
#include "client/rate_meter.h"
#include "client/viewer_state.h"
#include "common/net/url.h"
#include "sdk/contexts.h"
#include "tests/support/process.h"
#include "view/overlay.h"
#include "view/picture.h"

namespace eigencast {
namespace {

TEST(HudText, StatesRatesLatencyAndLevel) {
  HudFigures f;
  f.keys_hz = 29.97;
  f.poses_hz = 89.9;
  f.drawn_hz = 60.2;
  f.kbit_per_s = 56.4;
  f.latency_p50_us = 4'100;
  f.latency_p99_us = 38'400;
  f.latency_count = 10;
  f.vertices = 13'777;
  f.vertices_total = 32'802;
  f.faces = 27'550;
  f.bands = 3;
  f.bands_total = 4;
  f.rank = 200;
  f.received = true;
  f.mode = "raw";
  f.rebuilt = text_from_rebuilt(2, 2);
  const auto lines = hud_lines(f);
  ASSERT_EQ(lines.size(), 5u);
  EXPECT_EQ(lines[0], "30 keys/s \xC2\xB7 90 poses/s \xC2\xB7 60 drawn/s");
  EXPECT_EQ(lines[1], "56 kbit/s \xC2\xB7 latency 4.1 ms (p99 38 ms)");
  EXPECT_EQ(lines[2], "LOD 0.42 \xC2\xB7 13,777 of 32,802 vertices, 27,550 faces");
  EXPECT_EQ(lines[3], "raw");
  EXPECT_EQ(lines[4], "bands 3 of 4 \xC2\xB7 rank 200 \xC2\xB7 rebuilt on the GPU");
  f.received = false;
  EXPECT_EQ(hud_lines(f)[1], "latency 4.1 ms (p99 38 ms)") << "what is played here has no connection";
  EXPECT_EQ(hud_lines(f).size(), 4u);
  EXPECT_EQ(text_from_rebuilt(0, 2), "rebuilt on the CPU");
  EXPECT_EQ(text_from_rebuilt(1, 3), "rebuilt on the GPU: 1, on the CPU: 2");
}

TEST(HudText, SaysWhenNothingIsKnown) {
  const auto lines = hud_lines(HudFigures{});
  EXPECT_NE(lines[1].find("latency not known yet"), std::string::npos);
  EXPECT_NE(lines[2].find("points"), std::string::npos);
}

TEST(HudText, ModeNamesRateSchemeAndForm) {
  EXPECT_EQ(text_from_mode({Profile::Rate::kRaw, 3, Profile::Form::kFull, 8}), "raw");
  EXPECT_EQ(text_from_mode({Profile::Rate::kInterpolated, 4, Profile::Form::kCompact, 8}), "interpolated x4 compact");
  Profile estimated;
  estimated.rate = Profile::Rate::kEstimated;
  estimated.scheme = default_scheme(estimated.rate);
  EXPECT_EQ(text_from_mode(estimated), "estimated x3 damped full");
}

TEST(HudText, SaysWhatIsShown) {
  PlayoutSettings settings;
  EXPECT_EQ(text_from_shown(Shown::kLive, false, Playout(settings)), "live \xC2\xB7 as it comes");
  settings.mode = PlayoutMode::kEstimate;
  settings.smoothness = 0.25;
  EXPECT_EQ(text_from_shown(Shown::kEstimated, true, Playout(settings)),
            "estimated, going over \xC2\xB7 0.0 ms held back (smooth 25 %)");
  settings.delay_us = 80'000;
  EXPECT_EQ(text_from_shown(Shown::kHeld, false, Playout(settings)), "held \xC2\xB7 80 ms held back");
}

TEST(HudText, ConnectionLineCountsTheDownload) {
  Subscriber::Stats stats;
  stats.state = Subscriber::State::kDownloading;
  stats.asset_bytes_downloaded = 3'000'000;
  stats.asset_bytes_cached = 1'100'000;
  stats.asset_bytes_total = 11'300'000;
  EXPECT_EQ(connection_line(stats, std::nullopt), "downloading model 4.1 of 11.3 MB");
  EXPECT_EQ(connection_line(stats, std::nullopt, 1'000'000), "downloading model 4.1 of 11.3 MB, 8 s left");
  EXPECT_EQ(connection_line(stats, std::nullopt, 30'000), "downloading model 4.1 of 11.3 MB, 4 min left");
  // It can be drawn long before all of it is there.
  stats.state = Subscriber::State::kLive;
  stats.detail = "live, downloading detail";
  EXPECT_EQ(connection_line(stats, std::nullopt, 1'000'000), "live, downloading detail: 4.1 of 11.3 MB, 8 s left");
  stats.asset_bytes_downloaded = 10'200'000;
  stats.detail = "live";
  control::StreamInfo info;
  info.stream = "demo";
  EXPECT_EQ(connection_line(stats, info, 1'000'000), "live \xC2\xB7 demo");
  stats.detail = "the link takes 30 poses/s";
  EXPECT_EQ(connection_line(stats, info), "the link takes 30 poses/s \xC2\xB7 demo") << "what the broker says";
  stats.state = Subscriber::State::kLost;
  stats.detail = "next try in 400 ms";
  EXPECT_EQ(connection_line(stats, info), "lost \xC2\xB7 demo \xC2\xB7 next try in 400 ms");
  EXPECT_EQ(connection_line(stats, info, 0, true), "lost \xC2\xB7 demo") << "the banner says the rest";
  stats.state = Subscriber::State::kWaiting;
  stats.detail = "waiting for a sender at ws://h/demo";
  EXPECT_EQ(connection_line(stats, info), stats.detail) << "nothing twice";
}

TEST(HudText, BannerOnlyForASurfaceThatStandsStill) {
  Subscriber::Stats stats;
  stats.state = Subscriber::State::kLive;
  EXPECT_EQ(banner_text(stats, 3'200'000), "");
  stats.state = Subscriber::State::kLost;
  stats.detail = "next try in 400 ms";
  EXPECT_EQ(banner_text(stats, std::nullopt), "");  // nothing was ever shown: the connection line says it
  EXPECT_EQ(banner_text(stats, 3'200'000), "no data for 3.2 s - connection lost: next try in 400 ms");
}

TEST(RateMeter, WaitingForTheFirstIsNoPartOfTheRate) {
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

TEST(ViewerState, KeysDoWhatTheHelpSays) {
  ViewerState state;
  Camera camera;
  LevelOfDetail lod(0.5);
  const auto press = [&](const char* key) {
    const auto action = action_for_key(key);
    ASSERT_TRUE(action) << key;
    state.apply(*action, camera, lod);
  };
  press("E");
  EXPECT_TRUE(state.look.edges);
  press(" ");
  EXPECT_TRUE(state.paused);
  press("+");
  EXPECT_DOUBLE_EQ(lod.fraction(), 0.625);
  press(",");
  EXPECT_DOUBLE_EQ(lod.fraction(), 0.5);
  press("]");
  EXPECT_FALSE(state.playout.smoothness) << "nothing is held back that could be";
  press("M");
  EXPECT_EQ(state.playout.mode, PlayoutMode::kInterpolate);
  press("[");
  EXPECT_DOUBLE_EQ(*state.playout.smoothness, 0.875);
  press("M");
  EXPECT_EQ(state.playout.mode, PlayoutMode::kEstimate);
  EXPECT_EQ(Playout(state.playout).smoothness(), 0);
  press("]");
  EXPECT_DOUBLE_EQ(*state.playout.smoothness, 0.125);
  press("U");
  EXPECT_EQ(camera.up(), Camera::Up::kZ);
  press("F12");
  EXPECT_TRUE(state.screenshot_wanted);
  press("Escape");
  EXPECT_TRUE(state.quit);
  EXPECT_FALSE(action_for_key("J"));
  bool edges_on = false;
  for (const HelpLine& line : help_lines(state, camera, lod, ResolverKind::kNone))
    edges_on |= line.what == "edges" && line.state == "on";
  EXPECT_TRUE(edges_on);
}

class Files : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ =
        std::filesystem::temp_directory_path() / ("eigencast-client-" + std::to_string(::getpid()) +
                                                  ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string path(const char* name) const { return (folder_ / name).string(); }
  std::filesystem::path folder_;
};

TEST_F(Files, APictureComesBackAsItWasWritten) {
  Picture picture{5, 3, {}};
  for (int i = 0; i < 45; ++i) picture.rgb.push_back(static_cast<std::uint8_t>(i * 37));
  ASSERT_TRUE(write_png(path("a.png"), picture));
  const auto back = read_png(path("a.png"));
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->width, 5);
  EXPECT_EQ(back->height, 3);
  EXPECT_EQ(back->rgb, picture.rgb);
}

TEST_F(Files, PicturesThatCannotBeAreErrors) {
  EXPECT_EQ(write_png(path("a.png"), Picture{5, 3, {1, 2}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(write_png(path("a.png"), Picture{1, 1, {1, 2, 3}, {1, 2}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(write_png(path("none/a.png"), Picture{1, 1, {1, 2, 3}}).error().code, ErrorCode::kIo);
  std::ofstream(path("bad.png")) << "not a picture";
  EXPECT_EQ(read_png(path("bad.png")).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(read_png(path("absent.png")).error().code, ErrorCode::kIo);
}

TEST_F(Files, NamesThatNoFolderTakesAreErrorsNotExceptions) {
  const std::string name(300, 'x');
  EXPECT_EQ(read_png(path(name.c_str())).error().code, ErrorCode::kIo);
  EXPECT_EQ(next_screenshot_name(path(name.c_str())), path(name.c_str()) + "_0001.png");
}

TEST_F(Files, ScreenshotsNeverOverwrite) {
  const std::string prefix = path("shot");
  EXPECT_EQ(next_screenshot_name(prefix), prefix + "_0001.png");
  std::ofstream(prefix + "_0001.png") << "x";
  EXPECT_EQ(next_screenshot_name(prefix), prefix + "_0002.png");
}

std::variant<ClientOptions, ExitNow> parsed(std::vector<const char*> arguments) {
  ::setenv("XDG_CONFIG_HOME", "/nonexistent", 0);  // The contexts of whoever runs the tests are not theirs.
  arguments.insert(arguments.begin(), "eigencast-client");
  return options_from_command_line(static_cast<int>(arguments.size()), arguments.data());
}

TEST(Options, DefaultsAndTheQueryDecideUnlessAsked) {
  EXPECT_TRUE(std::get<ClientOptions>(parsed({})).scene.streams.empty()) << "the window asks";
  for (const char* name : {"--json", "--report"})
    EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless", name, "a.json"})).json, "a.json");
  const auto plain = parsed({"--headless"});
  ASSERT_TRUE(std::holds_alternative<ClientOptions>(plain));
  EXPECT_EQ(std::get<ClientOptions>(plain).scene.streams.front(), "ws://127.0.0.1:7490/demo");
  EXPECT_FALSE(std::get<ClientOptions>(plain).profile);
  EXPECT_EQ(std::get<ClientOptions>(plain).view_options.playout.delay_us, 0) << "follows the stream";
  const auto asked =
      parsed({"ws://h/a?rate=interpolated&k=5", "--form", "compact", "--size", "640x480", "--playout", "estimate"});
  ASSERT_TRUE(std::holds_alternative<ClientOptions>(asked));
  const auto& options = std::get<ClientOptions>(asked);
  ASSERT_TRUE(options.profile);
  EXPECT_EQ(options.profile->k, 5);
  EXPECT_EQ(options.profile->form, Profile::Form::kCompact);
  EXPECT_EQ(options.width, 640);
  EXPECT_EQ(options.height, 480);
  EXPECT_EQ(options.view_options.playout.mode, PlayoutMode::kEstimate);
  const auto estimated = std::get<ClientOptions>(parsed({"--rate", "estimated"}));
  EXPECT_EQ(estimated.profile->scheme, Profile::Scheme::kDamped) << "the default of its rate";
  const auto linear = std::get<ClientOptions>(parsed({"--rate", "estimated", "--scheme", "linear", "--k", "5"}));
  EXPECT_EQ(linear.profile->scheme, Profile::Scheme::kLinear);
}

TEST(Options, CredentialsComeFromFlagsUrlAndContexts) {
  const testing::TemporaryFolder folder;
  ::setenv("XDG_CONFIG_HOME", folder.path().c_str(), 1);
  Contexts contexts;
  ASSERT_TRUE(contexts.add({"studio", "wss://studio.example:443/eigencast/v1/subscribe/live/a", {"secret", "ca.pem"}}));
  ASSERT_TRUE(contexts.save(Contexts::default_path()));
  const auto options = [](std::vector<const char*> arguments) {
    return std::get<ClientOptions>(parsed(std::move(arguments)));
  };
  EXPECT_EQ(parse_broker_url(options({"live/b"}).scene.streams.front())->shown(),
            "wss://studio.example:443/eigencast/live/b");
  EXPECT_EQ(options({"live/b"}).credentials.front().token, "secret");
  EXPECT_EQ(options({"--token", "mine"}).credentials.front().token, "mine");
  EXPECT_EQ(options({"--token", "mine", "--insecure"}).credentials.front().ca_file, "ca.pem");
  EXPECT_TRUE(options({"--insecure"}).credentials.front().insecure);
  EXPECT_FALSE(options({}).credentials.front().insecure);
  EXPECT_EQ(options({"ws://other/x"}).credentials.front().token, "") << "another broker's";
  const auto shown = options({"ws://other/x?access_token=t.o.k&rate=raw"});
  EXPECT_EQ(shown.scene.streams.front(), "ws://other:7490/x?rate=raw");
  EXPECT_EQ(shown.credentials.front().token, "t.o.k");
  EXPECT_EQ(std::get<ExitNow>(parsed({"--context", "none"})).code, kExitUsage);
  // A token is for one broker: the first, or the context's that is named.
  const auto tokens = [&](std::vector<const char*> arguments) {
    std::vector<std::string> all;
    for (const Credentials& each : options(std::move(arguments)).credentials) all.push_back(each.token);
    return all;
  };
  using Tokens = std::vector<std::string>;
  EXPECT_EQ(tokens({"--token", "t", "file:heart", "ws://a/x", "wss://a/x", "ws://a:7490/y", "ws://b/x?access_token=u"}),
            (Tokens{"", "t", "", "t", "u"}));
  EXPECT_EQ(tokens({"--token", "t", "--context", "studio", "ws://a/x", "live/b"}), (Tokens{"", "t"}));
  EXPECT_EQ(tokens({"--token", "t", "ws://a/x", "live/b"}), (Tokens{"t", "secret"})) << "the context's own";
  ::setenv("EIGENCAST_TOKEN", "e", 1);
  EXPECT_EQ(tokens({"ws://a/x", "ws://b/x"}), (Tokens{"e", ""}));
  ::unsetenv("EIGENCAST_TOKEN");
  const auto others =
      options({"--token", "t", "--cert", "c", "--key", "k", "--ca", "ca", "--insecure", "ws://a/x", "ws://b/x"});
  EXPECT_EQ(others.credentials[1].certificate_file + others.credentials[1].key_file, "") << "who one is";
  EXPECT_FALSE(others.credentials[1].insecure);
  EXPECT_EQ(others.credentials[1].ca_file, "ca") << "whom one trusts";
  ::unsetenv("XDG_CONFIG_HOME");
}

TEST(Options, SeveralStreamsAndWhoChoosesTheLevels) {
  const auto window = std::get<ClientOptions>(parsed({"ws://h/a", "ws://h/b", "--target-fps", "30"}));
  EXPECT_EQ(window.scene.streams, (std::vector<std::string>{"ws://h/a", "ws://h/b"}));
  EXPECT_TRUE(window.scene.row);
  EXPECT_EQ(window.levels.kind, ResolverKind::kBudget);
  EXPECT_EQ(window.levels.target_fps, 30);
  EXPECT_FALSE(window.follow_display);
  EXPECT_TRUE(std::get<ClientOptions>(parsed({})).follow_display);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless"})).levels.kind, ResolverKind::kNone);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless", "--resolver", "paper"})).levels.kind, ResolverKind::kPaper);
}

TEST(Options, ViewTakesFilesAndShapes) {
  const auto view = std::get<ClientOptions>(parsed({"view", "heart", "a/b.obj", "--lod", "0.5"}));
  EXPECT_EQ(view.scene.streams, (std::vector<std::string>{"file:heart", "file:a/b.obj"}));
}

TEST(HudText, StatesEachSurfaceAndTheResolver) {
  HudFigures f;
  f.levels = {1, 0.42, 0.071};
  LevelSettings settings;
  settings.kind = ResolverKind::kPaper;
  settings.target_fps = 20;
  f.resolver = text_from_levels(LevelControl(settings), 0.0412);
  const auto lines = hud_lines(f);
  EXPECT_EQ(lines[3], "paper \xC2\xB7 20/s \xC2\xB7 41.2 of 50.0 ms \xC2\xB7 kappa 0.00");
  EXPECT_EQ(lines.back(), "of each 1.00 0.42 0.07");
}

TEST(Options, WrongUsageExitsWithTwo) {
  const std::vector<std::vector<const char*>> wrong{{"--size", "7"},
                                                    {"--size", "0x90"},
                                                    {"--lod", "2"},
                                                    {"--rate", "fast"},
                                                    {"--k", "99"},
                                                    {"--k", "3", "--rate", "raw"},
                                                    {"--rate", "raw", "--scheme", "linear"},
                                                    {"ws://h/a?rate=raw", "--form", "full"},
                                                    {"--scheme", "catmull-rom", "--form", "compact"},
                                                    {"--rate", "estimated", "--scheme", "hermite"},
                                                    {"--nonsense"},
                                                    {"view"},
                                                    {"--resolver", "x"},
                                                    {"--target-fps", "0"},
                                                    {"--scene", "/nonexistent.json"},
                                                    {"--colour", "red"},
                                                    {"--colour", "channel"},
                                                    {"--colour", "channel:2"},
                                                    {"--colour", "speed:3"},
                                                    {"--colour-map", "jet"},
                                                    {"--colour-range", "2,1"},
                                                    {"ws://h/a", "--scene", "/nonexistent.json"},
                                                    {"ws://h/a", "ftp://x/y"},
                                                    {"ftp://x/y"},
                                                    {"--out", "x"},
                                                    {"--headless", "--watch"},
                                                    {"--playout", "x"},
                                                    {"--smooth", "0.5"},
                                                    {"--playout", "estimate", "--smooth", "1.5"},
                                                    {"--playout", "estimate", "--smooth", "0.5", "--delay", "9"},
                                                    {"ws://h/a?rate=x"}};
  for (const auto& arguments : wrong) {
    const auto result = parsed(arguments);
    ASSERT_TRUE(std::holds_alternative<ExitNow>(result)) << arguments[0];
    EXPECT_EQ(std::get<ExitNow>(result).code, kExitUsage) << arguments[0];
  }
  EXPECT_EQ(std::get<ExitNow>(parsed({"--help"})).code, kExitGood);
}

TEST(TextScales, TextsAreAsLargeAsTheDisplayWantsThemInWhateverUnits) {
  EXPECT_EQ(text_scale(1, 1), (TextScale{1, 1}));
  EXPECT_EQ(text_scale(2, 1), (TextScale{2, 1})) << "X11, Windows: units are pixels";
  EXPECT_EQ(text_scale(2, 2), (TextScale{1, 2})) << "macOS, Wayland: units are two pixels, letters still sharp";
  EXPECT_EQ(text_scale(1.5F, 2), (TextScale{1, 2})) << "never smaller than at 96 dpi";
  EXPECT_EQ(text_scale(3, 1.5F), (TextScale{2, 1.5F}));
  EXPECT_EQ(text_scale(2, 2, 3), (TextScale{3, 2})) << "--ui-scale wins";
}

TEST(TextScales, AreSmallerInWindowsThatHaveNoRoomForThem) {
  EXPECT_EQ(fitted({1, 1}, 640, 480), (TextScale{1, 1}));
  EXPECT_EQ(fitted({2, 1}, 1280, 720), (TextScale{2, 1}));
  EXPECT_EQ(fitted({2, 1}, 480, 360), (TextScale{1.25F, 1})) << "five eighths at most";
  EXPECT_EQ(fitted({1, 2}, 300, 400), (TextScale{0.875F, 2})) << "in the window's units";
  EXPECT_EQ(fitted({4, 1}, 30, 20), (TextScale{2.5F, 1})) << "five eighths at least";
}

}  // namespace
}  // namespace eigencast
