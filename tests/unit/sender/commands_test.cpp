// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "common/surface/formats/write.h"
#include "sdk/contexts.h"
#include "sender/commands.h"
#include "tests/support/process.h"
#include "tests/unit/sender/reordered.h"

namespace eigencast {
namespace {

TEST(Play, EndsAfterDurationWithoutBroker) {
  testing::TemporaryFolder folder;
  PlayCommand command;
  command.source.input = "sphere";
  command.source.rank = 8;
  command.source.cache_dir = folder.file("cache");
  command.target.url = "ws://127.0.0.1:1/a";  // Where nobody listens.
  command.duration_s = 0.3;
  Interrupt interrupt;
  const TimeUs start = steady_now_us();
  EXPECT_EQ(run(command, Console{}, interrupt), kExitUnreachable);
  EXPECT_GE(steady_now_us() - start, 300'000);
}

/// Commands whose mistakes must be found before anything is baked: a bake would leave something in the cache.
class BeforeTheBake : public ::testing::Test {
 protected:
  template <typename Command>
  Command of_sphere() {
    Command command;
    command.source.input = "sphere";
    command.source.cache_dir = folder_.file("cache");
    if constexpr (requires { command.target; }) command.target.url = "ws://127.0.0.1:1/a";
    return command;
  }
  template <typename Command>
  void ends(const Command& command, int status, const std::string& what) {
    Interrupt interrupt;
    EXPECT_EQ(run(command, Console{}, interrupt), status) << what;
    EXPECT_FALSE(std::filesystem::exists(folder_.file("cache"))) << what;
  }
  std::string file(const std::string& name, const std::string& text) {
    std::ofstream(folder_.file(name)) << text;
    return folder_.file(name);
  }
  testing::TemporaryFolder folder_;
};

TEST_F(BeforeTheBake, PlayRefusesUnusableOptions) {
  auto play = of_sphere<PlayCommand>();
  play.record = folder_.file("no/record");
  ends(play, kExitFailed, "no folder for the record");
  play = of_sphere<PlayCommand>();
  play.target.credentials.token = "@" + folder_.file("no.token");
  ends(play, kExitUsage, "no token there");
  play = of_sphere<PlayCommand>();
  play.target.codec = "float32";
  play.target.bitrate_kbit = 10;
  ends(play, kExitUsage, "a bit rate of a codec that has none");
  play = of_sphere<PlayCommand>();
  play.source.input = file("a.off", "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n");
  play.velocities = true;
  ends(play, kExitFailed, "velocities of a pose");
}

TEST_F(BeforeTheBake, DeformReadsItsFiles) {
  for (const std::string& script :
       {std::string("twits"), folder_.file("no.json"), folder_.file(""), file("broken.json", "{"),
        file("typo.json", R"({"moves": [{"move": "twist", "axis": "y", "keys": [{"at": 0, "degree": 1}]}]})")}) {
    auto deform = of_sphere<DeformCommand>();
    deform.source.cage.resolution = 1;
    deform.script = script;
    ends(deform, kExitFailed, script);
  }
  auto deform = of_sphere<DeformCommand>();
  deform.script = "twist";
  deform.source.cage.file = file("open.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n");
  ends(deform, kExitFailed, "a cage that is not closed");
  deform = of_sphere<DeformCommand>();
  deform.script = "twist";
  deform.handles = file("handles.json", R"({"handles": [[0, 1], [1, 2]]})");
  ends(deform, kExitFailed, "a vertex in two handles");
}

TEST_F(BeforeTheBake, EvaluateChecksAllBases) {
  auto evaluate = of_sphere<EvaluateCommand>();
  evaluate.bases = {BasisKind::kAugmented, BasisKind::kRig};
  ends(evaluate, kExitFailed, "a sphere has no bones");
}

TEST_F(BeforeTheBake, PosesInAnotherOrderAreRefused) {
  const auto clip = folder_.file("clip.npy");
  ASSERT_TRUE(write_clip(Reordered(8), clip));  // The mesh beside it is in the right one.
  auto evaluate = of_sphere<EvaluateCommand>();
  evaluate.source.input = clip;
  ends(evaluate, kExitFailed, "most frames are in another order");
  auto play = of_sphere<PlayCommand>();
  play.source.input = clip;
  ends(play, kExitFailed, "likewise");
  auto bake = of_sphere<BakeCommand>();
  bake.source.input = folder_.file("clip.obj");
  bake.source.target_error = 0.01;
  bake.source.poses = clip;
  ends(bake, kExitFailed, "the poses that ranks are judged by");
}

TEST_F(BeforeTheBake, ExportLeavesOtherFilesAlone) {
  ExportCommand command;
  command.source.input = file("a.off", "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n");
  command.to = folder_.file("frames") + "/";
  Interrupt interrupt;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitOk);
  EXPECT_EQ(run(command, Console{}, interrupt), kExitFailed) << "those of the first";
  command.force = true;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitOk);
}

TEST_F(BeforeTheBake, ExportWritesOverNothingUnasked) {
  ExportCommand command;
  command.source.input = file("a.off", "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n");
  Interrupt interrupt;
  for (const char* name : {"x.obj", "x.npy", "x.html"}) {
    const std::string there = file(std::string(name) == "x.obj" ? "x_000000.obj" : name, "mine");
    command.to = folder_.file(name);
    EXPECT_EQ(run(command, Console{}, interrupt), kExitFailed) << name;
    EXPECT_EQ(std::filesystem::file_size(there), 4u) << name;
  }
  command.to = folder_.file("x.obj");
  command.force = true;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitOk);
  EXPECT_GT(std::filesystem::file_size(folder_.file("x_000000.obj")), 4u);
}

TEST_F(BeforeTheBake, ExportedRecordingsLeaveOtherFilesAlone) {
  const std::string recording = file("show.html.ecrec", "of another");
  auto command = of_sphere<ExportCommand>();
  command.source.rank = 8;
  command.to = folder_.file("show.html");
  Interrupt interrupt;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitOk);
  command.to = recording;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitFailed) << "no broker said no";
  EXPECT_EQ(std::filesystem::file_size(recording), 10u);
  std::ifstream page(folder_.file("show.html"));
  const std::string text{std::istreambuf_iterator<char>(page), {}};
  EXPECT_TRUE(text.find("RUNSRUNPUgo") != std::string::npos) << "ECRECOR in base 64";
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(std::filesystem::path(recording).parent_path()))
    files += entry.is_regular_file() ? 1 : 0;
  EXPECT_EQ(files, 2u) << "nothing half written";
}

TEST(UnnamedTarget, IsTheInputsNameAtTheBrokerThatIsKnown) {
  EXPECT_EQ(unnamed_target("heart", nullptr), "ws://127.0.0.1:7490/heart");
  EXPECT_EQ(unnamed_target("bar:twist", nullptr), "ws://127.0.0.1:7490/bar-twist");
  EXPECT_EQ(unnamed_target("/data/my clip.npy", nullptr), "ws://127.0.0.1:7490/my-clip");
  EXPECT_EQ(unnamed_target("frames/", nullptr), "ws://127.0.0.1:7490/frames");
  const Context broker{"b", "http://host:7490"}, stream{"s", "http://host:7490/live/a"};
  EXPECT_EQ(unnamed_target("heart", &broker), "heart");
  EXPECT_EQ(unnamed_target("heart", &stream), "") << "the context names it";
}

TEST(CommandLineOfTheSender, OptionsThatWouldDoNothingAreRefused) {
  const auto status = [](std::vector<const char*> words) {
    words.insert(words.begin(), "eigencast-sender");
    return parse_command_line(static_cast<int>(words.size()), const_cast<char**>(words.data())).status;
  };
  for (const auto& words : std::vector<std::vector<const char*>>{
           {"deform", "heart", "--to", "ws://h/a", "--once"},
           {"deform", "heart", "--to", "ws://h/a", "--speed", "2"},
           {"play", "heart", "--to", "ws://h/a", "--codec", "float32", "--error", "1"},
           {"play", "a.obj", "--to", "ws://h/a", "--animation", "Run"},
           {"export", "a.obj", "--to", "b.pc2", "--faces", "faces.npy"},
           {"export", "a.obj", "--to", "b.pc2", "--targets", "5"},
           {"export", "heart", "--to", "b.pc2", "--animation", "3"},
           {"export", "heart", "--to", "b.pc2", "--sample-rate", "5"},
           {"bake", "heart", "--animation", "x"},
           {"bake", "heart", "--faces", "f.npy"},
           {"bake", "heart", "--rest", "a.obj"},
           {"bake", "heart", "--any-order"},
           {"bake", "heart", "--basis", "pca", "--solver", "spectra"},
           {"bake", ".", "--animation", "0"},
           {"play", "heart", "--sample-rate", "10"},
           {"play", "heart", "--codec", "float32", "--memory", "on"},
           {"play", "heart", "--to", "http://h/a", "--insecure"},
           {"play", "heart", "--to", "http://h/a", "--ca", "nofile"},
           {"play", "heart", "--to", "https://h/a", "--cert", "a.pem"}})
    EXPECT_EQ(status(words), kExitUsage) << words.back();
  for (const auto& words :
       std::vector<std::vector<const char*>>{{"play", "heart", "--to", "https://h/a", "--insecure"},
                                             {"play", "heart", "--to", "name"},
                                             {"bake", "a.glb", "--animation", "0", "--sample-rate", "5"},
                                             {"bake", "a.ecrec", "--sample-rate", "5"},
                                             {"bake", "a.npy", "--faces", "f.npy", "--rest", "a.obj", "--any-order"},
                                             {"evaluate", "heart", "--basis", "pca,harmonic", "--solver", "spectra"},
                                             {"play", "heart", "--codec", "float32", "--memory", "off"}})
    EXPECT_EQ(status(words), kExitOk) << words.back();
  EXPECT_EQ(status({"deform", "heart", "--to", "ws://h/a", "--script", "twist", "--once"}), kExitOk);
  EXPECT_EQ(status({"export", "heart", "--to", "b.glb", "--targets", "5"}), kExitOk);
  EXPECT_EQ(status({"play", "heart"}), kExitOk) << "to this machine's broker";
  for (const char* command : {"play", "deform"}) {
    EXPECT_EQ(status({command, "heart", "--to", "ws://h/a", "--memory", "off"}), kExitOk) << command;
    EXPECT_EQ(status({command, "heart", "--to", "ws://h/a", "--memory", "some"}), kExitUsage) << command;
  }
}

TEST(ContextAdd, StoresAbsolutePathsAndRefusesMissingFiles) {
  const testing::TemporaryFolder folder;
  ::setenv("XDG_CONFIG_HOME", folder.file("config").c_str(), 1);
  std::ofstream(folder.file("token")) << "secret\n";
  ContextCommand command{"add", "studio", "ws://studio.example", {}};
  command.credentials.token = "@" + std::filesystem::relative(folder.file("token")).string();
  Interrupt interrupt;
  EXPECT_EQ(run(command, Console{}, interrupt), kExitOk);
  const auto contexts = Contexts::load(Contexts::default_path());
  ASSERT_TRUE(contexts && contexts->find("studio") != nullptr);
  EXPECT_EQ(contexts->find("studio")->credentials.token, "@" + folder.file("token"));
  command.name = "other";
  command.credentials.token += ".missing";
  EXPECT_EQ(run(command, Console{}, interrupt), kExitFailed);
  EXPECT_EQ(Contexts::load(Contexts::default_path())->find("other"), nullptr);
  ::unsetenv("XDG_CONFIG_HOME");
}

}  // namespace
}  // namespace eigencast
