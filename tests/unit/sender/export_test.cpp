// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <random>
#include <regex>
#include <variant>

#include "common/codec/chain.h"
#include "common/codec/pose_memory.h"
#include "common/codec/recaller.h"
#include "common/core/files.h"
#include "common/reconstruction/reconstruct.h"
#include "common/recording/reader.h"
#include "common/recording/writer.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/write.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/key_writer.h"
#include "sdk/publisher.h"
#include "sdk/recorded_clip.h"
#include "sdk/recorded_stream.h"
#include "sender/clip_part.h"
#include "sender/clip_recording.h"
#include "sender/cut.h"
#include "sender/morph_targets.h"
#include "sender/page_file.h"
#include "sender/source.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

double diagonal_of(const MotionClip& clip) {
  return bounding_box(clip.rest().positions).diagonal();
}

double largest_distance(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  EXPECT_EQ(a.size(), b.size());
  double largest = 0;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) largest = std::max(largest, length(a[i] - b[i]));
  return largest;
}

/// Of all poses of two clips of as many.
double largest_distance(const MotionClip& a, const MotionClip& b) {
  EXPECT_EQ(a.frame_count(), b.frame_count());
  double largest = 0;
  for (std::size_t f = 0; f < std::min(a.frame_count(), b.frame_count()); ++f)
    largest = std::max(largest, largest_distance(a.pose(f).value(), b.pose(f).value()));
  return largest;
}

/// Poses as a list, so that each can be told from its neighbours.
class ListedClip final : public MotionClip {
 public:
  explicit ListedClip(std::vector<std::vector<Vec3>> poses) : poses_(std::move(poses)) {
    rest_ = make_icosphere(2);
    if (!poses_.empty()) rest_.positions = poses_[0];
  }
  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return poses_.size(); }
  double frame_rate_hz() const override { return 20; }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override { return poses_.at(frame); }
  std::string name() const override { return "listed"; }

 private:
  std::vector<std::vector<Vec3>> poses_;
  Surface rest_;
};

/// Pose f of a ball whose vertex i moves in a direction of its own, by f^2.
std::unique_ptr<MotionClip> parabolic(std::size_t frames) {
  std::vector<std::vector<Vec3>> poses;
  for (std::size_t f = 0; f < frames; ++f) {
    poses.push_back(make_icosphere(2).positions);
    for (std::size_t i = 0; i < poses[f].size(); ++i)
      poses[f][i] = poses[f][i] + 0.001 * static_cast<double>(f * f) * Vec3{std::sin(1.0 * i), std::cos(2.0 * i), 1};
  }
  return std::make_unique<ListedClip>(std::move(poses));
}

TEST(ClipParts, TheWholeIsTheClip) {
  auto clip = parabolic(6);
  const MotionClip* before = clip.get();
  EXPECT_EQ(part_of(std::move(clip), {}).value().get(), before);
}

TEST(ClipParts, HoldTheirRangeAtTheirRate) {
  const auto part = part_of(parabolic(20), {0.25, 0.5, 40, 1}).value();
  const auto whole = parabolic(20);
  ASSERT_EQ(part->frame_count(), 20u);
  EXPECT_EQ(part->frame_rate_hz(), 40);
  for (std::size_t f = 0; f < 20; ++f) {
    if (f % 2 == 0) {
      EXPECT_EQ(part->pose(f).value(), whole->pose(5 + f / 2).value()) << "to the bit where the clip has it";
    }
    const double at = 5 + static_cast<double>(f) / 2;  // the curve is exact for parabolas
    const Vec3 moved = part->pose(f).value()[3] - whole->rest().positions[3];
    EXPECT_NEAR(moved[2], 0.001 * at * at, 1e-9) << f;
  }
  EXPECT_EQ(part_of(parabolic(20), {0.9, 0, 0, 1}).value()->frame_count(), 2u);
  EXPECT_EQ(part_of(parabolic(20), {1, 0, 0, 1}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(part_of(parabolic(20), {0, 0, 1e9, 1}).error().code, ErrorCode::kTooLarge);
}

TEST(ClipParts, LevelsAreSomeOfTheVertices) {
  const auto part = part_of(parabolic(20), {0, 0, 0, 0.25}).value();
  const auto whole = parabolic(20);
  const std::size_t n = part->rest().vertex_count();
  EXPECT_EQ(n, std::lround(0.25 * static_cast<double>(whole->rest().vertex_count())));
  ASSERT_TRUE(check_values(part->rest()));
  EXPECT_EQ(part->rest().faces.size(), 2 * n - 4) << "still a closed ball";
  const auto some = part->pose(7).value(), all = whole->pose(7).value();
  for (const Vec3& p : some) {
    EXPECT_NE(std::find(all.begin(), all.end(), p), all.end());
  }
}

TEST(MorphTargetsTest, ShowEveryPoseOfTheClip) {
  const testing::TemporaryFolder folder;
  for (const char* name : {"heart", "bar:twist"}) {
    const auto clip = part_of(builtin_clip(name).value(), {0, 1.5, 0, 1}).value();
    const auto made = morph_targets_of(*clip, 0, {});
    ASSERT_TRUE(made) << made.error().message;
    EXPECT_LE(made->largest_error, 1e-4);
    for (const float weight : made->motion.weights) EXPECT_TRUE(weight >= 0 && weight <= 1) << weight;
    EXPECT_LT(made->motion.targets, clip->frame_count() / 2) << "few: the motion is smooth";
    const std::string path = folder.file("a.glb");
    ASSERT_TRUE(write_morphed(*clip, made->motion, path));
    const auto read = open_clip(path, {{}, {}, {}, clip->frame_rate_hz()});
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ((*read)->rest().faces, clip->rest().faces);
    EXPECT_LE(largest_distance(**read, *clip), (made->largest_error + 1e-6) * diagonal_of(*clip)) << name;
  }
}

TEST(MorphTargetsTest, StateTheErrorOfTooFew) {
  const testing::TemporaryFolder folder;
  const auto clip = part_of(builtin_clip("heart").value(), {0, 1, 0, 1}).value();
  double before = 1;
  for (const std::size_t targets : {1u, 2u, 4u}) {
    const auto made = morph_targets_of(*clip, targets, {});
    ASSERT_TRUE(made) << made.error().message;
    EXPECT_EQ(made->motion.targets, targets);
    EXPECT_LT(made->rms_error, before);
    before = made->rms_error;
    ASSERT_TRUE(write_morphed(*clip, made->motion, folder.file("a.glb")));
    const auto read = open_clip(folder.file("a.glb"), {{}, {}, {}, clip->frame_rate_hz()}).value();
    EXPECT_NEAR(largest_distance(*read, *clip) / diagonal_of(*clip), made->largest_error, 1e-6);
  }
}

/// Each pose is another one: more directions than are held.
TEST(MorphTargetsTest, FindThePrincipalOnesOfMany) {
  std::vector<std::vector<Vec3>> poses;
  const std::size_t n = make_icosphere(2).vertex_count();
  for (std::size_t f = 0; f < 600; ++f) {
    poses.push_back(make_icosphere(2).positions);
    if (f == 0) continue;
    poses[f][f % n][f % 3] += 0.01;                                                 // noise of its own
    for (Vec3& p : poses[f]) p[1] += 0.1 * std::sin(0.1 * static_cast<double>(f));  // what all have in common
  }
  const ListedClip clip(std::move(poses));
  const auto one = morph_targets_of(clip, 1, {});
  ASSERT_TRUE(one);
  EXPECT_NEAR(one->rms_error * diagonal_of(clip), 0.01 / std::sqrt(static_cast<double>(n)), 2e-5);
  EXPECT_LE(morph_targets_of(clip, 0, {})->largest_error, 1e-4);
}

TEST(MorphTargetsTest, OfAStillClipDoNothing) {
  const ListedClip clip({make_icosphere(2).positions, make_icosphere(2).positions});
  const auto made = morph_targets_of(clip, 0, {});
  ASSERT_TRUE(made);
  EXPECT_EQ(made->motion.targets, 1u);
  EXPECT_EQ(made->largest_error, 0);
  EXPECT_EQ(morph_targets_of(clip, 0, [](double) { return false; }).error().code, ErrorCode::kCancelled);
}

TEST(Usd, HoldsEveryPoint) {
  const testing::TemporaryFolder folder;
  const auto clip = parabolic(3);
  ASSERT_TRUE(write_clip(*clip, folder.file("a.usda")));
  const std::string text = read_file(folder.file("a.usda"), 1 << 24).value();
  EXPECT_TRUE(text.starts_with("#usda 1.0\n"));
  EXPECT_EQ(std::count(text.begin(), text.end(), '{'), std::count(text.begin(), text.end(), '}'));
  EXPECT_EQ(std::count(text.begin(), text.end(), '['), std::count(text.begin(), text.end(), ']'));
  const std::regex sample(R"(\n +(\d+): \[\(([^\]]*)\)\],)");
  std::size_t samples = 0;
  const std::size_t points = text.find("points.timeSamples"), extents = text.find("extent.timeSamples");
  ASSERT_LT(points, extents);
  const std::string of_points = text.substr(points, extents - points);
  for (std::sregex_iterator it(of_points.begin(), of_points.end(), sample), end; it != end; ++it, ++samples) {
    const auto pose = clip->pose(std::stoul((*it)[1])).value();
    const std::string numbers = std::regex_replace((*it)[2].str(), std::regex("[(),]"), " ");
    const char* at = numbers.c_str();
    for (const Vec3& p : pose) {
      for (const double x : p) {
        char* next = nullptr;
        EXPECT_EQ(std::strtof(at, &next), static_cast<float>(x));
        ASSERT_NE(next, at);
        at = next;
      }
    }
    EXPECT_EQ(std::string(at).find_first_not_of(' '), std::string::npos);
  }
  EXPECT_EQ(samples, 3u);
}

/// Recordings of a ball, 25 poses a second, each a checkpoint; pose f is moved by f tenths of the second column.
class RecordedBalls : public ::testing::Test {
 protected:
  std::string record(const std::string& name, std::uint64_t poses, bool holds_surface = true) {
    std::string path = folder_.file(name);
    const Asset& asset = baked_.asset;
    auto writer = recording::Writer::create(path, {"lab/ball", "test", 0}).value();
    const auto add = [&](const AssetObject& object) { EXPECT_TRUE(writer.object(0, object.id.digest, object.bytes)); };
    if (holds_surface) add(baked_.encoded.manifest);
    for (const AssetObject& chunk : baked_.encoded.chunks) {
      if (holds_surface) add(chunk);
    }
    control::Announce announce;
    announce.asset = baked_.encoded.manifest.id.hex();
    announce.format = {layout_.rows, 3, layout_.band_ends, "float64"};
    announce.key_rate_hz = 25;
    EXPECT_TRUE(writer.announce(0, text_from_control(announce)));
    for (std::uint64_t f = 0; f < poses; ++f) {
      std::vector<double> C = asset.rest;
      C[3] += 0.1 * static_cast<double>(f);
      const Key key = key_from_coefficients(layout_, C, 0).value();
      Envelope envelope;
      envelope.kind = FrameKind::kJoin;
      envelope.bands = layout_.all_bands();
      envelope.sequence = f;
      envelope.capture_us = static_cast<TimeUs>(f) * 40'000;
      Bytes bytes;
      append_envelope(envelope, nullptr, bytes);
      const Bytes payload = encode_join(layout_, {key, key, 0}).value();
      bytes.insert(bytes.end(), payload.begin(), payload.end());
      EXPECT_TRUE(writer.checkpoint(envelope.capture_us, bytes));
    }
    EXPECT_TRUE(writer.finish());
    return path;
  }
  static BakeResult bake_ball() {
    BakeOptions options;
    options.rank = 20;
    return bake(make_icosphere(3), options, "").value();
  }
  /// By how many poses each one of a recording is moved, and when it is shown.
  static std::vector<std::pair<int, TimeUs>> poses_of(const std::string& path, const BakeResult& baked) {
    const auto clip = read_recording(path, "");
    EXPECT_TRUE(clip) << clip.error().message;
    std::vector<std::pair<int, TimeUs>> result;
    for (std::size_t f = 0; clip && f < clip->frames.size(); ++f)
      result.emplace_back(std::lround(10 * (clip->frames[f][3] - baked.asset.rest[3])), clip->times_us[f]);
    return result;
  }

  const testing::TemporaryFolder folder_;
  const BakeResult baked_ = bake_ball();
  const CoefficientLayout layout_{CodecKind::kFloat64, baked_.asset.rank, 3, baked_.asset.band_ends};
};

TEST_F(RecordedBalls, AreCutAndJoinedWithoutCodingAnew) {
  const std::string a = record("a.ecrec", 50), b = record("b.ecrec", 10), to = folder_.file("to.ecrec");
  const auto cut = cut_recordings({a}, 0.8, 0.4, 0, to);
  ASSERT_TRUE(cut) << cut.error().message;
  using Poses = std::vector<std::pair<int, TimeUs>>;
  Poses expected;
  for (int f = 20; f <= 30; ++f) expected.emplace_back(f, (f - 20) * 40'000);
  EXPECT_EQ(poses_of(to, baked_), expected);
  EXPECT_EQ(cut->bytes, std::filesystem::file_size(to));
  EXPECT_EQ(cut_recordings({a}, 0, 0, 0, to).error().code, ErrorCode::kInvalidArgument) << "it is there";
  const std::string joined = folder_.file("joined.ecrec");
  ASSERT_TRUE(cut_recordings({a, b, to}, 1.92, 0, 0, joined));
  expected = {{48, 0}, {49, 40'000}};
  for (int f = 0; f < 10; ++f) expected.emplace_back(f, 73'333 + f * 40'000);
  for (int f = 20; f <= 30; ++f) expected.emplace_back(f, 73'333 + 9 * 40'000 + 33'333 + (f - 20) * 40'000);
  EXPECT_EQ(poses_of(joined, baked_), expected);
  EXPECT_EQ(cut_recordings({a}, 9, 0, 0, folder_.file("none.ecrec")).error().code, ErrorCode::kInvalidArgument);
  EXPECT_FALSE(std::filesystem::exists(folder_.file("none.ecrec")));
  EXPECT_FALSE(std::filesystem::exists(folder_.file("none.ecrec.part")));
}

TEST_F(RecordedBalls, AreThinnedAtTheTimesNearestToTheRate) {
  const std::string a = record("a.ecrec", 50), to = folder_.file("to.ecrec");
  const auto cut = cut_recordings({a}, 0.8, 0.4, 10, to);
  ASSERT_TRUE(cut) << cut.error().message;
  const std::vector<std::pair<int, TimeUs>> expected{
      {20, 0}, {22, 80'000}, {25, 200'000}, {27, 280'000}, {30, 400'000}};
  EXPECT_EQ(poses_of(to, baked_), expected);
  EXPECT_EQ(cut->frames, 4u) << "and a checkpoint";
  const std::string same = folder_.file("same.ecrec");
  ASSERT_TRUE(cut_recordings({a}, 0, 0, 100, same));
  EXPECT_EQ(poses_of(same, baked_), poses_of(a, baked_)) << "no pose comes twice";
}

TEST_F(RecordedBalls, AreThinnedBeyondWhereTheyWereJoined) {
  const std::string a = record("a.ecrec", 50), joined = folder_.file("joined.ecrec"), to = folder_.file("to.ecrec");
  ASSERT_TRUE(cut_recordings({a, a}, 0, 0, 0, joined));
  ASSERT_TRUE(cut_recordings({joined}, 0, 0, 100, to));
  EXPECT_EQ(poses_of(to, baked_), poses_of(joined, baked_)) << "capture times begin again there";
}

TEST_F(RecordedBalls, PosesThatStayAreCodedAsCoarselyAndTakeLess) {
  const auto clip = parabolic(60);
  BakeOptions options;
  options.rank = 20;
  const BakeResult baked = bake(clip->rest(), options, "").value();
  const std::string whole = folder_.file("whole.ecrec"), half = folder_.file("half.ecrec");
  ASSERT_TRUE(record_clip(*clip, baked, whole, {}));
  ASSERT_TRUE(cut_recordings({whole}, 0, 0, 10, half));
  std::uint8_t coarse = 0;
  const auto bytes_of = [](const std::string& path) {
    double sum = 0;
    auto reader = recording::Reader::open(path).value();
    while (const auto record = reader.next().value())
      sum += record->type == recording::Type::kFrame ? static_cast<double>(record->body.size()) : 0;
    return sum;
  };
  const auto keys_of = [&](const std::string& path) {
    std::vector<Key> keys;
    auto stream = RecordedStream::open(path).value();
    for (;;) {
      const auto event = stream.next();
      EXPECT_TRUE(event);
      if (!event || !*event) return keys;
      const auto* pose = std::get_if<RecordedPose>(&(**event).what);
      if (pose == nullptr) continue;
      keys.push_back(pose->key);
      if (!pose->coded.empty()) coarse = half_spacing_of(pose->coded);
    }
  };
  const std::vector<Key> all = keys_of(whole), some = keys_of(half);
  ASSERT_EQ(all.size(), 60u);
  ASSERT_EQ(some.size(), 30u);
  EXPECT_EQ(some[0], all[0]);
  double off = 0;
  for (std::size_t i = 0; i < some.size(); ++i) {
    ASSERT_EQ(some[i].step, all[2 * i].step);
    for (std::size_t k = 0; k < some[i].q.size(); ++k) off += std::pow(some[i].q[k] - all[2 * i].q[k], 2);
  }
  const double rms = std::sqrt(off / static_cast<double>(some.size() * some[0].q.size()));
  EXPECT_GT(coarse, 0);
  EXPECT_LE(rms, coarse) << "of which the sender was off by 0.56 itself";
  EXPECT_LT(bytes_of(half), 0.7 * bytes_of(whole));
}

TEST_F(RecordedBalls, AreThinnedWithTheirMemory) {
  CoefficientLayout layout = layout_;
  layout.codec = CodecKind::kQuantised;
  const std::uint8_t step = quantiser_for_error(0.01, baked_.asset.area, baked_.asset.rank).step;
  std::vector<Key> keys;
  std::minstd_rand random(1);
  for (int f = 0; f < 40; ++f) {  // No pose says anything of the next.
    std::vector<double> C = baked_.asset.rest;
    for (double& c : C) c += std::uniform_real_distribution(-0.1, 0.1)(random);
    keys.push_back(key_from_coefficients(layout, C, step).value());
  }
  const CodedSegment segment = encode_segment(layout, baked_.encoded.manifest.id.digest, keys, 1).value();
  PoseMemory memory(layout);
  ASSERT_TRUE(memory.add(segment.segment));
  const auto thinned = [&](bool with_memory) {
    const std::string whole = folder_.file(with_memory ? "memory.ecrec" : "plain.ecrec"), half = whole + ".half";
    auto writer = recording::Writer::create(whole, {"lab/ball", "test", 0}).value();
    const Sha256 id = sha256(segment.bytes);
    EXPECT_TRUE(writer.object(0, id.digest, segment.bytes));
    control::Announce announce;
    announce.asset = baked_.encoded.manifest.id.hex();
    announce.format = {layout.rows, 3, layout.band_ends, "quantised"};
    EXPECT_TRUE(writer.announce(0, text_from_control(announce), with_memory ? ByteView(id.digest) : ByteView()));
    KeyWriter chain(layout, 1, {});
    chain.begin({});
    if (with_memory) {
      const auto recaller = std::make_shared<Recaller>(memory);
      const auto coder = [recaller](const auto& state, const Key& key, auto spacing) {
        return recaller->encode(state, key, spacing);
      };
      chain.code_by(coder, memory, false);
    }
    TimeUs due_us = 0;
    for (std::size_t f = 0; f < keys.size(); ++f) {
      const auto time_us = static_cast<TimeUs>(f) * 40'000;
      EXPECT_TRUE(record_key(writer, chain, chain.code(keys[f], time_us).value(), time_us, due_us));
    }
    EXPECT_TRUE(writer.finish());
    EXPECT_TRUE(cut_recordings({whole}, 0, 0, 12.5, half));
    return half;
  };
  std::size_t bytes[2] = {}, recalled = 0, poses = 0;
  for (const bool with_memory : {false, true}) {
    auto stream = RecordedStream::open(thinned(with_memory)).value();
    poses = 0;
    for (;;) {
      const auto event = stream.next();
      ASSERT_TRUE(event) << event.error().message;
      if (!*event) break;
      const auto* pose = std::get_if<RecordedPose>(&(**event).what);
      if (pose == nullptr) continue;
      bytes[with_memory ? 1 : 0] += pose->coded.size();
      recalled += pose->phase ? 1 : 0;
      const Key& sent = keys[2 * poses++];
      for (std::size_t k = 0; k < sent.q.size(); ++k) ASSERT_LE(std::abs(pose->key.q[k] - sent.q[k]), 4) << poses;
    }
    EXPECT_EQ(poses, keys.size() / 2);
  }
  EXPECT_GE(recalled, poses - 2);
  EXPECT_LT(bytes[1], bytes[0] / 3);
}

TEST_F(RecordedBalls, GetTheSurfaceThatTheyLack) {
  const std::string bare = record("bare.ecrec", 5, false), to = folder_.file("to.ecrec");
  const auto given = [&](const Sha256& id) -> Result<Bytes> {
    if (id == baked_.encoded.manifest.id) return baked_.encoded.manifest.bytes;
    for (const AssetObject& chunk : baked_.encoded.chunks) {
      if (chunk.id == id) return chunk.bytes;
    }
    return fail(ErrorCode::kNotFound, "another");
  };
  ASSERT_TRUE(cut_recordings({bare}, 0, 0, 0, to, given));
  EXPECT_EQ(poses_of(to, baked_).size(), 5u);
  ASSERT_TRUE(cut_recordings({bare}, 0, 0, 0, folder_.file("still.ecrec")));
  EXPECT_EQ(read_recording(folder_.file("still.ecrec"), "").error().code, ErrorCode::kNotFound);
  if (!player_page().empty()) {
    EXPECT_EQ(write_page(folder_.file("still.ecrec"), folder_.file("x.html"), {}).error().code, ErrorCode::kNotFound);
  }
}

/// As a mail or a page has it.
Bytes from_base64(std::string_view text) {
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  Bytes bytes;
  std::uint32_t bits = 0;
  int held = 0;
  for (const char digit : text) {
    if (digit == '=') break;
    bits = bits << 6 | static_cast<std::uint32_t>(digits.find(digit));
    if ((held += 6) < 8) continue;
    held -= 8;
    bytes.push_back(static_cast<std::uint8_t>(bits >> held));
  }
  return bytes;
}

TEST_F(RecordedBalls, AreInsidePages) {
  const std::string path = record("a.ecrec", 5), to = folder_.file("show.html");
  if (player_page().empty()) {
    EXPECT_EQ(write_page(path, to, {}).error().code, ErrorCode::kUnsupported);
    GTEST_SKIP() << "built without the page: npm ci in web/";
  }
  const std::string file = read_file(path, 1 << 24).value();
  ASSERT_TRUE(write_page(path, to, {}));
  const std::string html = read_file(to, 1 << 24).value(), before = "id=\"recording\">";
  const std::size_t begin = html.find(before) + before.size(), end = html.find('<', begin);
  ASSERT_LT(begin, end);
  const Bytes inside = from_base64(std::string_view(html).substr(begin, end - begin));
  EXPECT_EQ(std::string(inside.begin(), inside.end()), file);
  EXPECT_EQ(html.size(), player_page().size() - std::string("{recording}").size() + end - begin);

  EXPECT_EQ(write_page(path, folder_.file("no.html"), [](double) { return false; }).error().code,
            ErrorCode::kCancelled);
  EXPECT_FALSE(std::filesystem::exists(folder_.file("no.html")));
  EXPECT_FALSE(std::filesystem::exists(folder_.file("no.html.part")));
  EXPECT_EQ(write_page(folder_.file("none.ecrec"), to, {}).error().code, ErrorCode::kNotFound);
}

TEST(ClipRecordings, HoldTheClipAsItsSenderWouldSendIt) {
  const testing::TemporaryFolder folder;
  const auto clip = part_of(builtin_clip("heart").value(), {0, 0, 0, 0.05}).value();
  BakeOptions options;
  options.rank = 24;
  const BakeResult baked = bake(clip->rest(), options, "").value();
  const std::string to = folder.file("heart.ecrec");
  ASSERT_TRUE(record_clip(*clip, baked, to, {}));
  EXPECT_EQ(record_clip(*clip, baked, to, {}).error().code, ErrorCode::kRefused);
  const auto read = read_recording(to, "");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->info.asset, baked.encoded.manifest.id.hex());
  EXPECT_EQ(read->info.key_rate_hz, clip->frame_rate_hz());
  ASSERT_EQ(read->frames.size(), clip->frame_count());
  const auto projector = Projector::create(baked.asset).value();
  const double allowed = 1.5 * kDefaultErrorOverDiagonal * baked.asset.diagonal();
  for (std::size_t f = 0; f < read->frames.size(); ++f) {
    const auto pose = clip->pose(f).value();
    const auto C = projector.coefficients_from_positions(std::span(pose.data()->data(), 3 * pose.size())).value();
    EXPECT_LT(surface_distance(C, read->frames[f], baked.asset.area), allowed) << f;
    EXPECT_NEAR(static_cast<double>(read->times_us[f]), 1e6 * static_cast<double>(f) / clip->frame_rate_hz(), 1) << f;
  }
  EXPECT_EQ(recording::Reader::open(to)->index().size(), 1 + (clip->frame_count() - 1) / 30);
  EXPECT_EQ(
      record_clip(*clip, baked, folder.file("b.ecrec"), [](double, std::string_view) { return false; }).error().code,
      ErrorCode::kCancelled);
}

TEST_F(RecordedBalls, AreTheSendersSurface) {
  const std::string path = record("a.ecrec", 5);
  const Asset& asset = baked_.asset;
  SourceOptions source;
  source.input = path;
  const auto clip = open_source(source);
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->frame_count(), 5u);
  EXPECT_EQ((*clip)->frame_rate_hz(), 25);
  std::vector<float> rest(std::size_t{3} * asset.vertex_count);
  positions_from_coefficients(asset, asset.rest, 3, asset.rank, asset.vertex_count, rest);
  for (std::uint32_t row = 0; row < asset.vertex_count; ++row) {
    const Vec3 expected = Vec3{rest[3 * row], rest[3 * row + 1], rest[3 * row + 2]} + Vec3(asset.origin);
    EXPECT_LT(length((*clip)->rest().positions[asset.source_vertex[row]] - expected), 1e-6);
    const Vec3 moved = (*clip)->pose(4).value()[asset.source_vertex[row]] - expected;
    EXPECT_NEAR(moved[0], 0.4 * double{asset.entry(row, 1)}, 1e-6) << "x of the second column";
  }
  // The source's faces, perhaps in another order and from another corner on.
  const auto turned = [](std::vector<Face> faces) {
    for (Face& face : faces) std::rotate(face.begin(), std::min_element(face.begin(), face.end()), face.end());
    std::sort(faces.begin(), faces.end());
    return faces;
  };
  EXPECT_EQ(turned((*clip)->rest().faces), turned(make_icosphere(3).faces));
  source.sample_rate_hz = 50;
  const auto twice = open_source(source);
  ASSERT_TRUE(twice);
  EXPECT_EQ((*twice)->frame_count(), 10u);
  EXPECT_LT(largest_distance((*twice)->pose(4).value(), (*clip)->pose(2).value()), 1e-12);
}

}  // namespace
}  // namespace eigencast
