// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <fstream>

#include "common/surface/formats/clip.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "sender/deform/cage.h"
#include "sender/deform/script.h"
#include "sender/source.h"
#include "tests/support/paths.h"
#include "tests/system/scene.h"
#include "tools/compare/compare.h"

namespace eigencast::testing {
namespace {

constexpr std::size_t kFrames = 24;

/// The first frames of a built-in shape, rounded to 32-bit floats: what every format can hold.
class ShortClip final : public MotionClip {
 public:
  ShortClip()
      : clip_(std::move(*builtin_clip("sphere"))), rest_{rounded(clip_->rest().positions), clip_->rest().faces} {}
  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return kFrames; }
  double frame_rate_hz() const override { return 30; }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    // Its rest pose first, as formats without one take their first frame for it.
    return frame == 0 ? rest_.positions : rounded(*clip_->pose(frame));
  }
  std::string name() const override { return "short"; }

 private:
  static std::vector<Vec3> rounded(std::vector<Vec3> positions) {
    for (Vec3& p : positions) {
      for (double& x : p) x = static_cast<float>(x);
    }
    return positions;
  }
  std::unique_ptr<MotionClip> clip_;
  Surface rest_;
};

using Coefficients = std::map<std::size_t, std::vector<double>>;

void stop_sender(Scene& scene, Process& sender) {
  sender.signal(SIGTERM);
  EXPECT_EQ(sender.wait(kPatience), 0) << scene.logs();
}

/// What a client receives of most frames of `input`.
Coefficients played(const std::string& input) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto client = scene.start_client("viewer", {"--frames", "10000"});
  const auto sender = scene.start_sender({input, "--rate", "15", "--rank", "40", "--codec", "float64"});
  Coefficients received;
  EXPECT_TRUE(eventually(
      [&] {
        const SentFrames frames = scene.sent();
        for (const RecordedPose& pose : scene.received("viewer")) {
          const auto frame = frames.find(pose.capture_us);
          if (pose.is_key() && frame != frames.end()) received[frame->second] = pose.coefficients;
        }
        return received.size() >= 8;
      },
      kPatience))
      << scene.logs();
  stop_sender(scene, *sender);
  return received;
}

TEST(Formats, EveryFormatGivesTheSameCoefficients) {
  const TemporaryFolder folder;
  const ShortClip clip;
  Coefficients first;
  for (const std::string name : {"npy/a.npy", "pc2/a.pc2", "mdd/a.mdd", "obj/a.obj"}) {
    std::filesystem::create_directories(folder.path() / name.substr(0, 3));
    ASSERT_TRUE(write_clip(clip, folder.file(name)));
    const bool is_sequence = name.ends_with(".obj");
    const Coefficients received = played(is_sequence ? folder.file("obj") : folder.file(name));
    if (first.empty()) first = received;
    std::size_t common = 0;
    for (const auto& [frame, coefficients] : received) {
      const auto same = first.find(frame);
      if (same == first.end()) continue;
      EXPECT_EQ(coefficients, same->second) << name << ", frame " << frame;
      ++common;
    }
    EXPECT_GE(common, 4u) << name;
  }
}

TEST(Formats, PosesFromStandardInputArrive) {
  const TemporaryFolder folder;
  const ShortClip clip;
  ASSERT_TRUE(write_surface(clip.rest(), folder.file("rest.obj")));
  {
    std::ofstream out(folder.file("poses"), std::ios::binary);
    for (std::size_t frame = 0; frame < kFrames; ++frame) {
      const std::vector<Vec3> pose = *clip.pose(frame);
      for (const Vec3& p : pose) {
        for (const double x : p) {
          const auto value = static_cast<float>(x);
          out.write(reinterpret_cast<const char*>(&value), sizeof value);
        }
      }
    }
    out << "unfinished";
  }
  Scene scene;
  const auto broker = scene.start_broker();
  const auto client = scene.start_client("viewer", {"--frames", "10000"});
  Process sender(
      {"/bin/sh", "-c", "exec \"$0\" pipe --mesh \"$1\" --to \"$2\" --rate 15 --rank 40 --json \"$3\" < \"$4\"",
       bin_dir() + "/eigencast-sender", folder.file("rest.obj"), scene.url(), folder.file("report"),
       folder.file("poses")},
      scene.file("pipe.log"));
  EXPECT_EQ(sender.wait(milliseconds(60000)), 0) << sender.output() << scene.logs();
  EXPECT_NE(sender.output().find("10 bytes"), std::string::npos) << sender.output();
  EXPECT_EQ(sender.output().find("reading frames"), std::string::npos) << "no progress where there is no terminal";
  std::ifstream in(folder.file("report"));
  const std::string report((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  EXPECT_NE(report.find("\"poses\": 24"), std::string::npos) << report;
  EXPECT_NE(report.find("\"unfinished_bytes\": 10"), std::string::npos) << report;
  EXPECT_GE(scene.received("viewer").size(), 4u) << scene.logs();
}

/// What a client that got a clip as 64-bit floats, in this basis, is off by.
SurfaceError error_as_received(const SourceOptions& options) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto client = scene.start_client("viewer", {"--frames", "10000"});
  std::vector<std::string> arguments{options.input, "--basis", std::string(name_of(options.basis)), "--rate", "15",
                                     "--codec",     "float64"};
  if (options.basis == BasisKind::kCage) arguments.insert(arguments.end(), {"--cage", options.cage.file});
  if (!options.animation.empty()) arguments.insert(arguments.end(), {"--animation", options.animation});
  const auto sender = scene.start_sender(arguments);
  EXPECT_TRUE(eventually([&] { return scene.received("viewer").size() > 12; }, kPatience)) << scene.logs();
  stop_sender(scene, *sender);
  const auto source = bake_source(options, {});
  EXPECT_TRUE(source) << source.error().message;
  const auto compared = compare_with_truth(*source->clip, source->baked.asset, scene.sent(), scene.received("viewer"));
  EXPECT_TRUE(compared) << compared.error().message << scene.logs();
  EXPECT_EQ(source->baked.asset.basis_kind, name_of(options.basis));
  EXPECT_GE(compared->keys.poses, 4u) << scene.logs();
  return compared->keys;
}

TEST(Formats, CageAndPcaBasesArriveExactly) {
  const TemporaryFolder folder;
  const Surface model = make_heart(9);
  const auto cage = deform::cage_around(model, 2);
  ASSERT_TRUE(cage && write_surface(*cage, folder.file("cage.obj")));
  const auto deformer = deform::cage_deformer(model, *cage, deform::CageCoordinates::kGreen);
  const auto script = deform::Script::builtin("both", (*deformer)->handles());
  std::filesystem::create_directory(folder.file("clip"));
  for (int i = 0; i < 16; ++i) {
    const Surface pose{(*deformer)->positions(script->handles_at(i / 16.0)), model.faces};
    ASSERT_TRUE(write_surface(pose, folder.file("clip/" + std::to_string(i) + ".obj")));
  }
  SourceOptions options;
  options.input = folder.file("clip");
  options.basis = BasisKind::kCage;
  options.cage.file = folder.file("cage.obj");
  const SurfaceError of_cage = error_as_received(options);
  EXPECT_LT(of_cage.max, 1e-5);
  EXPECT_LT(of_cage.rms, 1e-6) << "rounding to 32-bit floats, of columns and of the file's digits";
  options.basis = BasisKind::kPca;
  options.cage = {};
  const SurfaceError learned = error_as_received(options);
  EXPECT_LT(learned.rms, 5e-4) << "16 poses are held by 16 columns; what storing them costs stays";
}

TEST(Formats, ARigBasisArrivesExactly) {
  SourceOptions options;
  options.input = rigged_file().string();
  options.animation = "Run";
  options.basis = BasisKind::kRig;
  const SurfaceError error = error_as_received(options);
  EXPECT_LT(error.max, 1e-5);
  EXPECT_LT(error.rms, 1e-6);
}

TEST(Formats, AnotherVertexOrderIsRefused) {
  const Scene scene;
  const auto clip = builtin_clip("heart");
  ASSERT_TRUE(write_surface((*clip)->rest(), scene.file("rest.obj")));
  std::filesystem::create_directory(scene.file("reversed"));
  for (const std::size_t frame : {0u, 7u, 14u}) {
    Surface pose{*(*clip)->pose(frame), {}};
    std::reverse(pose.positions.begin(), pose.positions.end());
    ASSERT_TRUE(write_surface(pose, scene.file("reversed/" + std::to_string(frame) + ".obj")));
  }
  const std::string rest = scene.file("rest.obj"), poses = scene.file("reversed");
  const std::vector<std::string> play{"play", poses, "--rest", rest, "--rank", "8", "--to", "ws://127.0.0.1:1/a"};
  const std::vector<std::string> evaluate{"evaluate", poses, "--rest", rest, "--rank", "8"};
  const std::vector<std::string> bake{"bake", rest, "--poses", poses, "--target-error", "0.9"};
  const auto said_by = [&](std::vector<std::string> arguments, int status) {
    arguments.insert(arguments.begin(), bin_dir() + "/eigencast-sender");
    Process sender(arguments, scene.file("sender.log"));
    EXPECT_EQ(sender.wait(milliseconds(60000)), status) << sender.output();
    return sender.output();
  };
  for (const auto& command : {play, evaluate, bake}) {
    const std::string said = said_by(command, 1);
    EXPECT_NE(said.find("--any-order takes them as they are"), std::string::npos) << command[0] << said;
  }
  auto all_the_same = evaluate;
  all_the_same.push_back("--any-order");
  const std::string said = said_by(all_the_same, 0);
  EXPECT_NE(said.find("frames 0 to 2: "), std::string::npos) << said;
}

// What a user has: whole files, real motion. The sender reads and checks each to its end before it plays some of it.
TEST(Formats, EveryRealClipPlays) {
  std::vector<std::string> inputs{rigged_file(), morphing_file()};
  for (const auto& entry : std::filesystem::directory_iterator(data_dir() / "animations"))
    inputs.push_back(entry.path());
  for (const std::string& input : inputs) {
    Scene scene;
    const auto broker = scene.start_broker();
    const auto client = scene.start_client("viewer", {"--frames", "10000"});
    const auto sender = scene.start_sender({input, "--rate", "15", "--rank", "24"});
    EXPECT_TRUE(eventually([&] { return !scene.received("viewer").empty(); }, milliseconds(120000)))
        << input << scene.logs();
    stop_sender(scene, *sender);
    EXPECT_EQ(sender->output().find("frame "), std::string::npos) << "no finding in good motion: " << sender->output();
  }
}

TEST(Formats, AnAbsentBrokerHasItsOwnExitStatus) {
  const Scene scene;
  Process sender({bin_dir() + "/eigencast-sender", "play", "sphere", "--rank", "8", "--to", "ws://127.0.0.1:1/a",
                  "--duration", "0.3"},
                 scene.file("sender.log"));
  EXPECT_EQ(sender.wait(milliseconds(60000)), 4) << sender.output();
}

}  // namespace
}  // namespace eigencast::testing
