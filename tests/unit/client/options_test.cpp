// SPDX-License-Identifier: MIT
#include "client/options.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>

#include "client/clip_source.h"
#include "common/net/url.h"
#include "sdk/contexts.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

std::variant<ClientOptions, ExitNow> parsed(std::vector<const char*> arguments) {
  ::setenv("XDG_CONFIG_HOME", "/nonexistent", 0);  // Tests do not use the contexts of the user who runs them.
  arguments.insert(arguments.begin(), "eigencast-client");
  return options_from_command_line(static_cast<int>(arguments.size()), arguments.data());
}

TEST(Options, DefaultsAndTheQueryDecideUnlessAsked) {
  EXPECT_TRUE(std::get<ClientOptions>(parsed({})).scene.streams.empty()) << "the window asks";
  for (const char* name : {"--json", "--report"})
    EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless", name, "a.json"})).json, "a.json");
  const auto plain = parsed({"--headless"});
  ASSERT_TRUE(std::holds_alternative<ClientOptions>(plain));
  EXPECT_TRUE(std::get<ClientOptions>(plain).scene.streams.empty());
  EXPECT_EQ(std::get<ClientOptions>(plain).home.url, "ws://127.0.0.1:7490") << "whose one live stream is meant";
  EXPECT_EQ(std::get<ClientOptions>(plain).style.colour.colouring, Colouring::kAuto);
  EXPECT_FALSE(std::get<ClientOptions>(plain).profile);
  EXPECT_EQ(std::get<ClientOptions>(plain).view_options.playout.delay_us, 0) << "follows the stream";
  const auto asked =
      parsed({"ws://h/a?rate=interpolated&k=5", "--scheme", "hermite", "--size", "640x480", "--playout", "estimate"});
  ASSERT_TRUE(std::holds_alternative<ClientOptions>(asked));
  const auto& options = std::get<ClientOptions>(asked);
  ASSERT_TRUE(options.profile);
  EXPECT_EQ(options.profile->k, 5);
  EXPECT_EQ(options.profile->scheme, Profile::Scheme::kHermite);
  EXPECT_EQ(options.width, 640);
  EXPECT_EQ(options.height, 480);
  EXPECT_EQ(options.view_options.playout.mode, PlayoutMode::kEstimate);
  const auto estimated = std::get<ClientOptions>(parsed({"--rate", "estimated"}));
  EXPECT_EQ(estimated.profile->scheme, Profile::Scheme::kDamped) << "the default of its rate";
  const auto linear = std::get<ClientOptions>(parsed({"--rate", "estimated", "--scheme", "linear", "--k", "5"}));
  EXPECT_EQ(linear.profile->scheme, Profile::Scheme::kLinear);
}

TEST(Options, AGroupEstimatesWhatComesLate) {
  const auto playout_of = [](std::vector<const char*> words) {
    return std::get<ClientOptions>(parsed(std::move(words))).view_options.playout;
  };
  const PlayoutSettings usual = playout_of({"ws://h/a", "--sync", "g"});
  EXPECT_EQ(usual.mode, PlayoutMode::kEstimate);
  EXPECT_EQ(Playout(usual).smoothness(), 1) << "where it is in step with nobody, poses are waited for";
  EXPECT_EQ(playout_of({"ws://h/a", "--sync", "g", "--playout", "interpolate"}).mode, PlayoutMode::kInterpolate);
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
  EXPECT_EQ(shown.scene.streams.front(), "ws://other:80/x?rate=raw");
  EXPECT_EQ(shown.credentials.front().token, "t.o.k");
  EXPECT_EQ(options({"ws://a,b:1/x?access_token=t"}).scene.streams.front(), "ws://a:80,b:1/x");
  EXPECT_EQ(std::get<ExitNow>(parsed({"--context", "none"})).code, kExitUsage);
  // A token is for one broker: the first, or the context's that is named.
  const auto tokens = [&](std::vector<const char*> arguments) {
    std::vector<std::string> all;
    for (const Credentials& each : options(std::move(arguments)).credentials) all.push_back(each.token);
    return all;
  };
  using Tokens = std::vector<std::string>;
  EXPECT_EQ(tokens({"--token", "t", "file:heart", "ws://a/x", "wss://a/x", "ws://a:80/y", "ws://b/x?access_token=u"}),
            (Tokens{"", "t", "", "t", "u"}));
  EXPECT_EQ(tokens({"--token", "t", "--context", "studio", "ws://a/x", "live/b"}), (Tokens{"", "t"}));
  EXPECT_EQ(tokens({"--token", "t", "ws://a/x", "live/b"}), (Tokens{"t", "secret"})) << "the context's own";
  ::setenv("EIGENCAST_TOKEN", "e", 1);
  EXPECT_EQ(tokens({"ws://a/x", "ws://b/x"}), (Tokens{"e", ""}));
  ::unsetenv("EIGENCAST_TOKEN");
  const auto others =
      options({"--token", "t", "--cert", "c", "--key", "k", "--ca", "ca", "--insecure", "wss://a/x", "wss://b/x"});
  EXPECT_EQ(others.credentials[1].certificate_file + others.credentials[1].key_file, "") << "one's identity";
  EXPECT_FALSE(others.credentials[1].insecure);
  EXPECT_EQ(others.credentials[1].ca_file, "ca") << "whom one trusts";
  ::unsetenv("XDG_CONFIG_HOME");
}

TEST(Options, ResolverDefaultsToBudgetInTheWindow) {
  const auto window = std::get<ClientOptions>(parsed({"ws://h/a", "ws://h/b", "--target-fps", "30"}));
  EXPECT_EQ(window.scene.streams, (std::vector<std::string>{"ws://h/a", "ws://h/b"}));
  EXPECT_TRUE(window.scene.row);
  EXPECT_EQ(window.levels.kind, ResolverKind::kBudget);
  EXPECT_EQ(window.levels.target_fps, 30);
  EXPECT_FALSE(window.follow_display);
  EXPECT_TRUE(std::get<ClientOptions>(parsed({})).follow_display);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless"})).levels.kind, ResolverKind::kNone);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless"})).levels.quality, QualityMode::kFull);
  EXPECT_EQ(std::get<ClientOptions>(parsed({})).levels.quality, QualityMode::kAuto);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--quality", "low"})).levels.quality, QualityMode::kLow);
  EXPECT_EQ(std::get<ClientOptions>(parsed({"--headless", "--resolver", "paper"})).levels.kind, ResolverKind::kPaper);
}

TEST(Options, ViewTakesFilesAndShapes) {
  const testing::TemporaryFolder folder;
  const std::string mesh = folder.file("b.obj");
  std::ofstream(mesh) << "v 0 0 0\n";
  const auto view = std::get<ClientOptions>(parsed({"view", "heart", mesh.c_str(), "a/*.obj", "--lod", "0.5"}));
  EXPECT_EQ(view.scene.streams, (std::vector<std::string>{"file:heart", "file:" + mesh, "file:a/*.obj"}));
  for (const char* stream : {"http://h/a", "ws://h/a"})
    EXPECT_EQ(std::get<ExitNow>(parsed({"view", stream})).code, kExitUsage) << stream;
  for (const char* missing : {"nosuchdir", "a/nosuchdir", "none.obj"}) {
    ::testing::internal::CaptureStderr();
    EXPECT_EQ(std::get<ExitNow>(parsed({"view", missing})).code, kExitUsage) << missing;
    const std::string said = ::testing::internal::GetCapturedStderr();
    for (const std::string& part : {std::string(missing), std::string("folder"), std::string("torus")})
      EXPECT_NE(said.find(part), std::string::npos) << said;
  }
}

TEST(Options, ANameWithoutABrokerSaysWhatToGive) {
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(std::get<ExitNow>(parsed({"heart"})).code, kExitUsage);
  const std::string said = ::testing::internal::GetCapturedStderr();
  for (const char* part : {"heart: ", "http://host:7490/heart", "context add", "eigencast-client view heart"})
    EXPECT_NE(said.find(part), std::string::npos) << said;
}

TEST(Options, ExistingPathsAreFilesOtherWordsStreams) {
  const testing::TemporaryFolder folder;
  const std::string mesh = folder.file("a mesh.obj"), scene = folder.file("s.json");
  std::ofstream(mesh) << "v 0 0 0\n";
  std::ofstream(scene) << R"({"surfaces": [{"file": "heart"}, {"stream": "ws://h/a"}]})";
  const auto streams = [](const std::string& word) {
    return std::get<ClientOptions>(parsed({word.c_str()})).scene.streams;
  };
  using Streams = std::vector<std::string>;
  EXPECT_EQ(streams(mesh), Streams{"file:" + mesh});
  EXPECT_EQ(streams(folder.path().string()), Streams{"file:" + folder.path().string()}) << "a folder";
  EXPECT_EQ(streams(folder.file("*.obj")), Streams{"file:" + folder.file("*.obj")}) << "a glob";
  EXPECT_EQ(streams("file:" + mesh), Streams{"file:" + mesh});
  EXPECT_EQ(clip_in(streams("FILE://" + mesh).front()), mesh);
  EXPECT_EQ(streams("host/a"), Streams{"host/a"});
  EXPECT_EQ(streams("host/a?rate=raw"), Streams{"host/a?rate=raw"});
  EXPECT_EQ(streams("[::1]:7490/a"), Streams{"[::1]:7490/a"});
  EXPECT_EQ(streams(scene), (Streams{"file:heart", "ws://h/a"}));
  for (const std::string& missing :
       {folder.file("none.obj"), std::string("none.ply"), std::string("./none"), folder.file("none"),
        "file://" + folder.file("none.obj"), "file://elsewhere" + mesh})
    EXPECT_EQ(std::get<ExitNow>(parsed({missing.c_str()})).code, kExitUsage) << missing;
}

TEST(Options, FileUrlsArePaths) {
  EXPECT_EQ(clip_in("file:///tmp/a%20b.obj"), "/tmp/a b.obj");
  EXPECT_EQ(clip_in("file://localhost/tmp/%C3%A4.obj"), "/tmp/\xC3\xA4.obj");
  EXPECT_EQ(clip_in("file:///a%2"), "/a%2");
  EXPECT_EQ(clip_in("file:///a%zz%00"), "/a%zz%00") << "not an escape, and no path has a zero byte";
  EXPECT_EQ(clip_in("file:a%20b.obj"), "a%20b.obj") << "no URL";
  EXPECT_FALSE(clip_in("http://h/a"));
}

TEST(Options, ListNamesABroker) {
  const auto home = [](std::vector<const char*> arguments) {
    const auto options = std::get<ClientOptions>(parsed(std::move(arguments)));
    EXPECT_TRUE(options.list);
    EXPECT_TRUE(options.scene.streams.empty());
    return parse_broker_url(options.home.url)->origin() + " " + options.home.credentials.token;
  };
  EXPECT_EQ(home({"list"}), "ws://127.0.0.1:7490 ");
  EXPECT_EQ(home({"list", "http://host", "--token", "t"}), "ws://host:80 t");
  EXPECT_EQ(home({"list", "host"}), "ws://host:7490 ");
  EXPECT_EQ(home({"list", "https://host", "--token", "t", "--insecure", "-v", "--json", "-"}), "wss://host:443 t");
  for (const auto& wrong : std::vector<std::vector<const char*>>{
           {"list", "a", "b"}, {"list", "--headless"}, {"list", "host:81/a"}, {"list", "http://host/foo"}})
    EXPECT_EQ(std::get<ExitNow>(parsed(wrong)).code, kExitUsage);
  const testing::TemporaryFolder folder;
  std::ofstream(folder.file("a.obj")) << "v 0 0 0\n";
  EXPECT_EQ(std::get<ExitNow>(parsed({"list", folder.file("a.obj").c_str()})).code, kExitUsage);
  ::setenv("EIGENCAST_URL", "http://host:82/", 1);
  EXPECT_EQ(home({"list"}), "ws://host:82 ");
  EXPECT_EQ(home({"list", "host:81"}), "ws://host:81 ");
  const auto nothing_named = std::get<ClientOptions>(parsed({}));
  ::unsetenv("EIGENCAST_URL");
  EXPECT_TRUE(nothing_named.scene.streams.empty()) << "the one live stream there";
  EXPECT_EQ(parse_broker_url(nothing_named.home.url)->origin(), "ws://host:82");
}

TEST(Options, ABrokerStandsForItsOnlyStream) {
  const auto options = std::get<ClientOptions>(parsed({"http://host:7490", "--token", "t"}));
  EXPECT_TRUE(options.scene.streams.empty());
  EXPECT_EQ(parse_broker_url(options.home.url)->origin(), "ws://host:7490");
  EXPECT_EQ(options.home.credentials.token, "t");
}

TEST(Options, WordsHaveHelpOfTheirOwn) {
  std::set<std::string> texts;
  for (const char* word : {"list", "view", "completion"}) {
    ::testing::internal::CaptureStdout();
    EXPECT_EQ(std::get<ExitNow>(parsed({word, "--help"})).code, kExitGood);
    const std::string text = ::testing::internal::GetCapturedStdout();
    EXPECT_NE(text.find("eigencast-client " + std::string(word)), std::string::npos);
    texts.insert(text);
  }
  EXPECT_EQ(texts.size(), 3u);
}

TEST(Options, OptionsThatWouldDoNothingAreRefused) {
  const std::vector<std::vector<const char*>> useless{{"--hud"},
                                                      {"view", "heart", "--token", "t"},
                                                      {"--wait", "3"},
                                                      {"--first"},
                                                      {"--headless", "--first"},
                                                      {"--headless", "--turntable", "3"},
                                                      {"--fps", "30"},
                                                      {"--seconds", "3"},
                                                      {"view", "heart", "--film", "a.mp4", "--frames", "3"},
                                                      {"view", "heart", "--film", "a.mp4", "--out", "b"},
                                                      {"view", "heart", "--film", "a.mp4", "--transparent"},
                                                      {"view", "heart", "--film", "a.mp4", "--playout", "estimate"},
                                                      {"view", "heart", "--film", "a.mp4", "--fps", "0"},
                                                      {"view", "heart", "--film", "a.avi"},
                                                      {"http://h/a", "--film", "a.mp4"},
                                                      {"--film", "a.mp4"},
                                                      {"--headless", "--settings", "x"},
                                                      {"--headless", "--ui-scale", "2"},
                                                      {"--headless", "--lod-floor", "0.1"},
                                                      {"--resolver", "paper", "--quality", "auto"},
                                                      {"--headless", "--colour-map", "grey"},
                                                      {"--headless", "--colour", "own", "--colour-range", "0,1"},
                                                      {"--headless", "--truth", "heart"},
                                                      {"--headless", "--frames", "1", "--hud"},
                                                      {"--headless", "--frames", "1", "--transparent"},
                                                      {"--edges", "--wireframe"},
                                                      {"--edges", "--points"},
                                                      {"--wireframe", "--points"},
                                                      {"http://h/a", "--insecure"},
                                                      {"http://h/a", "--ca", "ca.pem"},
                                                      {"http://h/a", "--cert", "a.pem", "--key", "a.key"},
                                                      {"https://h/a", "--cert", "a.pem"},
                                                      {"http://h/a", "--colour", "error"},
                                                      {"view", "heart", "--truth", "heart"},
                                                      {"view", "heart", "--headless", "--wait", "3"},
                                                      {"list", "http://h", "--turntable", "3"},
                                                      {"list", "http://h", "--points"},
                                                      {"list", "http://h", "--screenshot", "x.png"},
                                                      {"list", "http://h", "--room", "a"},
                                                      {"list", "http://h", "--insecure"},
                                                      {"ws://h/a", "--watch"},
                                                      {"view", "heart", "--rate", "raw"},
                                                      {"view", "heart", "--bands", "2"},
                                                      {"view", "heart", "--insecure"},
                                                      {"view", "heart", "--memory", "100"},
                                                      {"--playout", "interpolate", "--ahead", "9"},
                                                      {"--camera-path", "x.json", "--view", "top"}};
  for (const auto& arguments : useless) {
    const auto result = parsed(arguments);
    ASSERT_TRUE(std::holds_alternative<ExitNow>(result)) << arguments.back();
    EXPECT_EQ(std::get<ExitNow>(result).code, kExitUsage) << arguments.back();
  }
  const std::vector<std::vector<const char*>> useful{
      {"--headless", "--frames", "1", "--first", "--hud", "--ui-scale", "2", "--wait", "3", "--out", "a"},
      {"--headless", "--frames", "1", "--room", "a", "--ui-scale", "2", "--transparent", "--screenshot", "a.png"},
      {"https://h/a", "--insecure"},
      {"http://h/a", "--compare", "https://h/b", "--ca", "ca.pem"},
      {"http://h/a", "--headless", "--colour", "error", "--truth", "heart"},
      {"view", "heart", "--colour", "error"},
      {"--headless", "--resolver", "budget", "--lod-floor", "0.1"},
      {"view", "heart", "--film", "a_%d.png", "--transparent", "--hud", "--turntable", "3"},
      {"http://h/a", "--film", "a.mp4", "--fps", "24", "--seconds", "3"},
      {"view", "heart", "--turntable", "3"},
      {"--headless", "--colour", "speed", "--colour-map", "grey"},
      {"--colour-map", "grey", "--settings", ""},
      {"view", "heart", "--watch"},
      {"--playout", "estimate", "--ahead", "9"}};
  for (const auto& arguments : useful)
    EXPECT_TRUE(std::holds_alternative<ClientOptions>(parsed(arguments))) << arguments.back();
}

TEST(Options, ResultsThatCannotBeWrittenAreFoundAtOnce) {
  const testing::TemporaryFolder folder;
  for (const char* option : {"--screenshot", "--json", "--record", "--record-shown"})
    EXPECT_EQ(std::get<ExitNow>(parsed({"view", "heart", option, folder.file("none/a.png").c_str()})).code, kExitFailed)
        << option;
  EXPECT_EQ(std::get<ExitNow>(parsed({"view", "heart", "--screenshot", folder.file("a.jpg").c_str()})).code,
            kExitUsage);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(Options, TheEnvironmentIsNotRefusedWhereItDoesNothing) {
  for (const char* name : {"EIGENCAST_TOKEN", "EIGENCAST_NAME"}) {
    ::setenv(name, "x", 1);
    EXPECT_TRUE(std::holds_alternative<ClientOptions>(parsed({"view", "heart"}))) << name;
    EXPECT_TRUE(std::get<ClientOptions>(parsed({"list", "http://h"})).list) << name;
    ::unsetenv(name);
  }
}

TEST(Options, WrongUsageExitsWithTwo) {
  const std::vector<std::vector<const char*>> wrong{{"--size", "7"},
                                                    {"--size", "0x90"},
                                                    {"--lod", "2"},
                                                    {"--rate", "fast"},
                                                    {"--k", "99"},
                                                    {"--k", "3", "--rate", "raw"},
                                                    {"--rate", "raw", "--scheme", "linear"},
                                                    {"ws://h/a?rate=raw", "--scheme", "linear"},
                                                    {"--form", "full"},
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

}  // namespace
}  // namespace eigencast
