// SPDX-License-Identifier: MIT
// One sender, one broker, viewers of different kinds: what comes out is the sender's surface.
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>

#include "broker/relay/stream.h"
#include "common/codec/key.h"
#include "common/motion/curve.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"
#include "sdk/frame_decoder.h"
#include "sdk/key_writer.h"
#include "sdk/publisher.h"
#include "tests/support/paths.h"
#include "tests/system/scene.h"

namespace eigencast::testing {
namespace {

nlohmann::json report_of(const Scene& scene, const std::string& client) {
  std::ifstream in(scene.file(client + ".json"));
  return nlohmann::json::parse(in, nullptr, false);
}

std::size_t count_keys(const std::vector<RecordedPose>& poses) {
  return static_cast<std::size_t>(std::count_if(poses.begin(), poses.end(), [](const auto& p) { return p.is_key(); }));
}

/// How many poses two clients both received.
std::size_t common_steps(const Scene& scene, const std::string& one, const std::string& other) {
  const auto steps = by_step(scene.received(one));
  std::size_t common = 0;
  for (const auto& [step, pose] : by_step(scene.received(other))) common += steps.contains(step);
  return common;
}

/// Streams a gait in the given basis to one viewer at full detail and one late viewer at a fifth of the vertices.
class Gait : public ::testing::Test {
 protected:
  /// detail: of harmonic bases.
  void stream(BasisKind kind, Scene& scene, const std::string& detail = "none") {
    const std::string input = gait_clip().string(), basis(name_of(kind));
    ASSERT_EQ(scene.run("bake", {"eigencast-sender", "bake", input, "--basis", basis, "--detail", detail}), 0)
        << scene.logs();
    const auto broker = scene.start_broker();
    const auto sender = scene.start_sender({input, "--basis", basis, "--detail", detail, "--rate", "30",
                                            // Until a viewer has a memory it gets another coding of the same poses.
                                            "--memory", "off"});
    const auto full = scene.start_client("full", {"--frames", "1000000", "--lod", "1"});
    ASSERT_TRUE(eventually([&] { return scene.received("full").size() > 60; }, kPatience)) << scene.logs();
    const auto coarse = scene.start_client("coarse", {"--frames", "1000000", "--lod", "0.2", "--rate", "raw"});
    ASSERT_TRUE(eventually([&] { return common_steps(scene, "full", "coarse") > 10; }, kPatience)) << scene.logs();
    ASSERT_TRUE(eventually([&] { return count_keys(scene.received("full")) > 20; }, kPatience)) << scene.logs();
    for (const auto* client : {&coarse, &full}) {
      (*client)->signal(SIGTERM);
      ASSERT_EQ((*client)->wait(kPatience), 0) << scene.logs();
    }
    sender->signal(SIGTERM);
    EXPECT_EQ(sender->wait(kPatience), 0) << scene.logs();
    broker->signal(SIGTERM);
    EXPECT_EQ(broker->wait(kPatience), 0) << scene.logs();
  }

  /// The error of all keys that the viewer at full detail received.
  Comparison compare(BasisKind basis, const Scene& scene, DetailKind detail = DetailKind::kNone) {
    const auto clip = open_gait();
    const KnownMotion motion = motion_of(*clip);
    const BakeOptions options{.basis = basis, .rank = 200, .name = {}, .motion = &motion, .detail = detail};
    const auto baked = bake(clip->rest(), options, default_cache_dir());
    EXPECT_TRUE(baked) << baked.error().message;
    const auto comparison = compare_with_truth(*clip, baked->asset, scene.sent(), scene.received("full"));
    EXPECT_TRUE(comparison) << comparison.error().message;
    return *comparison;
  }

  static std::unique_ptr<MotionClip> open_gait() {
    auto clip = open_clip(gait_clip().string());
    EXPECT_TRUE(clip) << clip.error().message;
    return clip ? std::move(*clip) : nullptr;
  }

  struct Bounds {
    double min_percent, max_percent;
  };
  /// The error of the keys lies within those of horse-gallop, or of the clip that stands in.
  static void expect_error(const Comparison& comparison, Bounds horse, Bounds made) {
    const Bounds bounds = has_data("animations/horse-gallop") ? horse : made;
    EXPECT_GT(comparison.keys.poses, 20u);
    EXPECT_EQ(comparison.unmatched, 0u);
    EXPECT_GT(comparison.keys.kg_percent, bounds.min_percent);
    EXPECT_LT(comparison.keys.kg_percent, bounds.max_percent);
  }
};

TEST_F(Gait, AugmentedArrivesWithThePredictedError) {
  Scene scene;
  stream(BasisKind::kAugmented, scene);
  if (HasFatalFailure()) return;
  expect_error(compare(BasisKind::kAugmented, scene), {0.85, 1.02}, {0.40, 0.54});
}

TEST_F(Gait, HarmonicArrivesWithThePredictedError) {
  Scene scene;
  stream(BasisKind::kHarmonic, scene);
  if (HasFatalFailure()) return;
  expect_error(compare(BasisKind::kHarmonic, scene), {2.05, 2.30}, {1.14, 1.50});
}

/// Half of what the basis alone leaves (above): viewers put the rest back.
TEST_F(Gait, HarmonicWithDetailArrivesWithHalfTheError) {
  Scene scene;
  stream(BasisKind::kHarmonic, scene, "frames");
  if (HasFatalFailure()) return;
  expect_error(compare(BasisKind::kHarmonic, scene, DetailKind::kFrames), {1.02, 1.15}, {0.43, 0.58});
}

TEST_F(Gait, ViewersOfDifferentDetailSeeTheSameMotion) {
  Scene scene;
  stream(BasisKind::kAugmented, scene);
  if (HasFatalFailure()) return;
  const auto full = by_step(scene.received("full"));
  const auto coarse = by_step(scene.received("coarse"));
  ASSERT_FALSE(coarse.empty());
  EXPECT_GT(coarse.begin()->first.first, full.begin()->first.first) << "the second viewer came later";
  for (const auto& [step, pose] : coarse) {
    ASSERT_TRUE(pose.is_key()) << "raw mode delivers keys only";
    const auto other = full.find(step);
    if (other == full.end()) continue;
    EXPECT_EQ(other->second.coefficients, pose.coefficients);
    EXPECT_EQ(other->second.capture_us, pose.capture_us);
  }
  const std::size_t vertices = open_gait()->rest().vertex_count();
  EXPECT_EQ(report_of(scene, "full")["lod"]["vertices"].get<std::size_t>(), vertices);
  EXPECT_LT(report_of(scene, "coarse")["lod"]["vertices"].get<std::size_t>(), vertices / 4);
}

/// How many intervals between consecutive keys have both poses, 1/3 and 2/3. Each pose is Eq. 7 of its neighbours to
/// rounding, and there are no others. Latest wins: in real time poses may be missing anywhere.
std::size_t whole_intervals(const std::vector<RecordedPose>& poses, double rounding) {
  const auto steps = by_step(poses);
  std::size_t whole = 0;
  for (const auto& [step, after] : steps) {
    const std::uint64_t s = step.first;
    const auto before = steps.find({s - 1, {0, 0}});
    if (!after.is_key() || before == steps.end()) continue;
    int found = 0;
    for (int at = 1; at < 3; ++at) {
      const auto middle = steps.find({s, {at, 3}});
      if (middle == steps.end()) continue;
      ++found;
      const double u = at / 3.0;
      for (std::size_t i = 0; i < after.coefficients.size(); ++i) {
        const double a = before->second.coefficients[i], b = after.coefficients[i];
        EXPECT_NEAR(middle->second.coefficients[i], a + u * (b - a), rounding)
            << "value " << i << " of " << at << "/3 before " << s;
      }
    }
    whole += found == 2;
  }
  for (const RecordedPose& pose : poses) EXPECT_TRUE(pose.is_key() || pose.of == 3) << "a pose that is not a third";
  return whole;
}

/// What the broker's stream gives a viewer, decoded.
class Decoded : public broker::Watcher {
 public:
  void on_stream_changed(const broker::Stream& stream, bool) override {
    const control::StreamInfo info = stream.info_for(*this);
    reader_.begin(info.stream_id, info.tag, info.epoch);
    decoder_.set_stream(info);
  }
  void on_frames(const broker::Stream&, std::span<const broker::FramePtr> frames) override {
    for (const broker::FramePtr& frame : frames) {
      const auto parsed = parse_frame(frame->message());
      ASSERT_TRUE(parsed);
      const auto view = reader_.read(*parsed);
      ASSERT_TRUE(view);
      const auto key = decoder_.decode(*view);
      ASSERT_TRUE(key) << key.error().message;
      if (!*key) continue;  // Sent ahead.
      const Envelope& head = view->envelope;
      poses.push_back({head.sequence, head.step.at, head.step.of, head.is_ahead() ? shown_us(head) : head.capture_us,
                       decoder_.layout().channels, coefficients_from_key(decoder_.layout(), **key)});
    }
  }
  void on_trace(const std::shared_ptr<const std::string>&) override {}

  std::vector<RecordedPose> poses;

 private:
  EnvelopeReader reader_;
  FrameDecoder decoder_;
};

class NoSender : public broker::PublisherLink {
  void on_watcher_count(std::uint32_t) override {}
};

class Interpolated : public ::testing::TestWithParam<std::string> {
 public:
  static Asset asset_of(const MotionClip& clip) {
    const KnownMotion motion = motion_of(clip);
    auto baked = bake(clip.rest(), {.name = {}, .motion = &motion}, default_cache_dir());
    EXPECT_TRUE(baked);
    return std::move(baked->asset);
  }
  static Quantiser quantiser_of(const Asset& asset) {
    return quantiser_for_error(kDefaultErrorOverDiagonal * asset.diagonal(), asset.area, asset.rank);
  }

 protected:
  /// Of a pose against Eq. 7 of its keys: half a step.
  static double rounding(const Quantiser& quantiser) {
    return codec() == "quantised" ? 0.5001 * step_size(quantiser.step) : codec() == "float32" ? 1e-5 : 1e-12;
  }
  static const std::string& codec() { return GetParam(); }
};

TEST(StreamList, TheOneLiveStreamNeedsNoName) {
  Scene scene;
  const auto broker = scene.start_broker();
  const std::string home = "http://127.0.0.1:" + scene.port();
  ::setenv("XDG_CONFIG_HOME", scene.file("config").c_str(), 1);
  ASSERT_EQ(scene.run("context", {"eigencast-sender", "context", "add", "here", home}), 0) << scene.logs();
  const auto listed = [&](const std::string& name) {
    EXPECT_EQ(scene.run(name, {"eigencast-client", "list", home, "--json", scene.file(name + ".json")}), 0);
    return nlohmann::json::parse(std::ifstream(scene.file(name + ".json")));
  };
  const std::vector<std::string> nameless{"eigencast-client", "--headless", "--frames", "1",
                                          "--size",           "160x120",    "--json",   scene.file("shown.json")};
  EXPECT_TRUE(listed("empty").empty());
  EXPECT_EQ(scene.run("nobody", nameless), 4);
  const auto sender = scene.start_sender({"torus", "--rate", "30"});
  ASSERT_TRUE(eventually([&] { return listed("one").size() == 1 && listed("one")[0]["state"] == "live"; }, kPatience))
      << scene.logs();
  EXPECT_EQ(listed("one")[0]["stream"], "live/test");
  EXPECT_EQ(scene.run("shown", nameless), 0) << scene.logs();
  EXPECT_EQ(nlohmann::json::parse(std::ifstream(scene.file("shown.json")))["stream"], "live/test");
  const auto second = scene.start_sender({"sphere", "--rate", "30"}, home + "/live/other");
  ASSERT_TRUE(eventually([&] { return listed("two").size() == 2; }, kPatience)) << scene.logs();
  ASSERT_TRUE(eventually([&] { return listed("two")[0]["state"] == listed("two")[1]["state"]; }, kPatience));
  EXPECT_EQ(scene.run("which", nameless), 4) << "several are live";
  EXPECT_EQ(scene.run("away", {"eigencast-client", "list", "ws://127.0.0.1:1"}), 4);
  ::unsetenv("XDG_CONFIG_HOME");
}

TEST_P(Interpolated, TheRateTriples) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "20", "--codec", codec()});
  const auto client = scene.start_client("a", {"--frames", "1000000"});
  const auto clip = builtin_clip("torus");
  const double tolerance = rounding(quantiser_of(asset_of(**clip)));
  EXPECT_TRUE(eventually([&] { return whole_intervals(scene.received("a"), tolerance) >= 10; }, kPatience))
      << scene.logs();
  client->signal(SIGTERM);
  ASSERT_EQ(client->wait(kPatience), 0) << scene.logs();
  EXPECT_EQ(report_of(scene, "a")["bands"]["received"], 4);
}

/// The way of `keys` poses of the torus, each `stride`-th, but for sockets, on a stepped clock: nothing is late, so
/// nothing is missing.
struct Stepped {
  std::vector<RecordedPose> poses;
  Quantiser quantiser;
};
void step_through(const Profile& profile, const std::string& codec, std::size_t keys, std::size_t stride,
                  Stepped& out) {
  const auto clip = builtin_clip("torus");
  const Asset asset = Interpolated::asset_of(**clip);
  const auto projector = Projector::create(asset);
  ASSERT_TRUE(projector);
  const Quantiser quantiser = out.quantiser = Interpolated::quantiser_of(asset);
  const CoefficientLayout layout{codec_from_name(codec).value(), asset.rank, 3, default_band_ends(asset.rank)};
  KeyWriter writer(layout, codec == "quantised" ? quantiser.half_spacing : std::uint8_t{0}, std::nullopt);
  broker::Stream stream("live/test", 7, broker::Stream::Settings{});
  NoSender sender;
  Decoded viewer;
  ASSERT_TRUE(stream.watch(viewer, profile));
  ASSERT_TRUE(stream.claim(sender));
  control::Announce announce;
  announce.asset = std::string(64, 'a');
  announce.format = {asset.rank, 3, layout.band_ends, codec};
  announce.key_rate_hz = 20;
  ASSERT_TRUE(stream.announce(announce, 1));
  writer.begin({"live/test", 7, 1, stream.tag()});

  constexpr TimeUs kIntervalUs = 50'000;
  TimeUs now_us = 1'000'000;
  for (std::size_t i = 0; i < keys; ++i) {
    const auto positions = (*clip)->pose(i * stride % (*clip)->frame_count());
    std::vector<double> flat;
    for (const Vec3& vertex : *positions) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto coefficients = projector->coefficients_from_positions(std::span<const double>(flat));
    ASSERT_TRUE(coefficients);
    const auto key = key_from_coefficients(layout, *coefficients, quantiser.step);
    ASSERT_TRUE(key);
    auto coded = writer.code(*key, now_us);
    ASSERT_TRUE(coded) << coded.error().message;
    ASSERT_TRUE(stream.add_frame(coded->message, now_us));
    const std::size_t bytes = coded->message.size();
    writer.sent(std::move(*coded), bytes);
    for (const TimeUs end_us = now_us + kIntervalUs; now_us < end_us; now_us += 1000) stream.pump(now_us);
  }
  for (const TimeUs end_us = now_us + 10 * kIntervalUs; now_us < end_us; now_us += 1000) stream.pump(now_us);
  EXPECT_EQ(viewer.poses.size(), 1 + 3 * (keys - 1));
  out.poses = std::move(viewer.poses);
}

TEST_P(Interpolated, EveryIntervalTriplesOnASteppedClock) {
  constexpr std::size_t kKeys = 60;
  Stepped seen;
  step_through(Profile{}, codec(), kKeys, 1, seen);
  if (HasFatalFailure()) return;
  EXPECT_EQ(whole_intervals(seen.poses, rounding(seen.quantiser)), kKeys - 1);
}

/// Against the curve through the viewer's own keys, whose interval is one.
TEST_P(Interpolated, CurvedPosesLieWithinHalfASpacing) {
  constexpr std::size_t kKeys = 30;
  Stepped seen;
  step_through({Profile::Rate::kInterpolated, 3, 8, Profile::Scheme::kCatmullRom}, codec(), kKeys, 10, seen);
  if (HasFatalFailure()) return;
  const double half_spacing =
      codec() != "quantised" ? 1e-5 : (seen.quantiser.half_spacing + 0.5001) * step_size(seen.quantiser.step);
  const auto steps = by_step(seen.poses);
  std::size_t checked = 0;
  double bent = 0;
  for (const RecordedPose& pose : seen.poses) {
    const auto key = [&](int ahead) { return steps.find({pose.sequence + static_cast<std::uint64_t>(ahead), {0, 0}}); };
    if (pose.is_key() || key(-2) == steps.end() || key(1) == steps.end()) continue;
    const CurveWeights w = catmull_rom_weights(0, 3, 6, 9, 3 + pose.at);
    ++checked;
    for (std::size_t i = 0; i < pose.coefficients.size(); ++i) {
      const auto at = [&](int ahead) { return key(ahead)->second.coefficients[i]; };
      const double curve = w.before * at(-2) + w.from * at(-1) + w.to * at(0) + w.after * at(1);
      ASSERT_NEAR(pose.coefficients[i], curve, half_spacing)
          << i << " of " << int{pose.at} << "/3 before " << pose.sequence;
      bent = std::max(bent, std::abs(pose.coefficients[i] - at(-1) - (at(0) - at(-1)) * pose.at / 3.0));
    }
  }
  EXPECT_EQ(checked, 2 * (kKeys - 3));
  EXPECT_GT(bent, half_spacing) << "a straight line would not do";
}

INSTANTIATE_TEST_SUITE_P(Codecs, Interpolated, ::testing::Values("quantised", "float32", "float64"));

TEST(Raw, DeliversExactlyWhatWasSent) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "30", "--codec", "float64"});
  const auto client = scene.start_client("a", {"--frames", "1000000", "--rate", "raw"});
  ASSERT_TRUE(eventually([&] { return scene.received("a").size() > 30; }, kPatience)) << scene.logs();
  client->signal(SIGTERM);
  ASSERT_EQ(client->wait(kPatience), 0) << scene.logs();

  const auto clip = builtin_clip("torus");
  const KnownMotion motion = motion_of(**clip);
  const auto baked = bake((*clip)->rest(), {.name = {}, .motion = &motion}, default_cache_dir());
  ASSERT_TRUE(baked);
  const auto projector = Projector::create(baked->asset);
  ASSERT_TRUE(projector);
  const SentFrames sent = scene.sent();
  const auto poses = scene.received("a");
  for (const RecordedPose& pose : poses) {
    EXPECT_TRUE(pose.is_key());
    ASSERT_TRUE(sent.contains(pose.capture_us));
    const auto positions = (*clip)->pose(sent.at(pose.capture_us));
    std::vector<double> flat;
    for (const Vec3& vertex : *positions) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto coefficients = projector->coefficients_from_positions(std::span<const double>(flat));
    ASSERT_TRUE(coefficients);
    EXPECT_EQ(pose.coefficients, *coefficients) << "to the last bit: the codec is float64";
  }
}

TEST(Bands, FewerBandsAreTheFirstColumns) {
  Scene scene;
  const auto broker = scene.start_broker();
  const auto sender = scene.start_sender({"torus", "--rate", "30"});
  const auto all = scene.start_client("all", {"--frames", "1000000", "--rate", "raw"});
  const auto few = scene.start_client("few", {"--frames", "1000000", "--rate", "raw", "--bands", "2"});
  ASSERT_TRUE(eventually([&] { return common_steps(scene, "all", "few") > 20; }, kPatience)) << scene.logs();
  for (const auto* client : {&all, &few}) {
    (*client)->signal(SIGTERM);
    ASSERT_EQ((*client)->wait(kPatience), 0) << scene.logs();
  }
  const auto whole = by_step(scene.received("all"));
  for (const auto& [step, pose] : by_step(scene.received("few"))) {
    const auto other = whole.find(step);
    if (other == whole.end()) continue;
    for (std::size_t i = 0; i < 54 * 3; ++i) EXPECT_EQ(pose.coefficients[i], other->second.coefficients[i]);
    for (std::size_t i = 54 * 3; i < pose.coefficients.size(); ++i)
      EXPECT_NEAR(pose.coefficients[i], 0, 1e-6) << "rest pose";
  }
  const auto bytes_per_frame = [&](const char* client) {
    const auto frames = report_of(scene, client)["frames_in"];
    return frames["bytes"].get<double>() / (frames["keys"].get<double>() + frames["joins"].get<double>());
  };
  EXPECT_LT(bytes_per_frame("few"), bytes_per_frame("all"));
}

}  // namespace
}  // namespace eigencast::testing
