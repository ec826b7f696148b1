// SPDX-License-Identifier: MIT
#include "client/clip_source.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "common/codec/chain.h"
#include "common/core/files.h"
#include "common/recording/writer.h"
#include "common/surface/shapes/shapes.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/asset_cache.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

constexpr int kPoses = 20;
constexpr TimeUs kInterval = 40'000;

/// A recording of a sphere whose pose k is moved to x = k, as joins and keys.
class RecordedClips : public ::testing::Test {
 protected:
  void SetUp() override {
    BakeOptions options;
    options.name = "ball";
    auto baked = bake(make_icosphere(2), options, "");
    ASSERT_TRUE(baked) << baked.error().message;
    baked_ = std::make_unique<BakeResult>(std::move(*baked));
    layout_ = {CodecKind::kFloat64, baked_->asset.rank, 3, baked_->asset.band_ends};
  }

  Key key(int number) const {
    std::vector<double> C = baked_->asset.rest;
    C[0] = number;
    return key_from_coefficients(layout_, C, 0).value();
  }

  void announce(recording::Writer& writer, TimeUs time_us, const std::string& asset, bool continues = false) const {
    control::Announce announce;
    announce.continues = continues;
    announce.asset = asset;
    announce.format = {layout_.rows, 3, layout_.band_ends, "float64"};
    announce.key_rate_hz = 25;
    EXPECT_TRUE(writer.announce(time_us, text_from_control(announce)));
  }
  std::string own_asset() const { return baked_->encoded.manifest.id.hex(); }

  /// Pose `number` as a join, captured at capture_us and recorded at time_us.
  void join(recording::Writer& writer, int number, TimeUs capture_us, TimeUs time_us) const {
    Envelope envelope;
    envelope.kind = FrameKind::kJoin;
    envelope.bands = layout_.all_bands();
    envelope.sequence = static_cast<std::uint64_t>(number);
    envelope.capture_us = capture_us;
    Bytes bytes;
    append_envelope(envelope, nullptr, bytes);
    const Bytes payload = encode_join(layout_, {key(number), key(number), 0}).value();
    bytes.insert(bytes.end(), payload.begin(), payload.end());
    EXPECT_TRUE(writer.checkpoint(time_us, bytes));
  }

  void write(bool with_objects, const std::string& asset_later = {}) {
    std::filesystem::remove(path_);
    auto writer = recording::Writer::create(path_, {"lab/ball", "test", 0}).value();
    const auto add = [&](const AssetObject& object) { EXPECT_TRUE(writer.object(0, object.id.digest, object.bytes)); };
    if (with_objects) {
      add(baked_->encoded.manifest);
      for (const AssetObject& chunk : baked_->encoded.chunks) add(chunk);
    }
    announce(writer, 0, own_asset());
    // Arrivals jitter; captures do not.
    for (int k = 0; k < kPoses; ++k) join(writer, k, 7'000'000 + k * kInterval, k * kInterval + (k % 3) * 9000);
    join(writer, kPoses - 1, 7'000'000 + (kPoses - 1) * kInterval, kPoses * kInterval);  // of what is there
    const TimeUs later = (kPoses - 1) * kInterval + 60'000'000;
    if (!asset_later.empty()) {
      announce(writer, later, asset_later);
      join(writer, kPoses, 3, later);
    }
    EXPECT_TRUE(writer.finish());
  }

  const testing::TemporaryFolder folder_;
  const std::string path_ = folder_.file("a.ecrec");
  std::unique_ptr<BakeResult> baked_;
  CoefficientLayout layout_;
};

TEST_F(RecordedClips, HoldEveryPoseAtItsCaptureTime) {
  write(true);
  const auto clip = BakedClip::open(path_, "");
  ASSERT_TRUE(clip) << clip.error().message;
  ASSERT_EQ((*clip)->frames.size(), static_cast<std::size_t>(kPoses));
  for (std::size_t k = 0; k < kPoses; ++k) {
    EXPECT_EQ((*clip)->frames[k][0], static_cast<double>(k));
    EXPECT_EQ((*clip)->times_us[k], static_cast<TimeUs>(k) * kInterval);
  }
  EXPECT_EQ((*clip)->period_us, kPoses * kInterval);
  EXPECT_FALSE((*clip)->is_cycle);
  EXPECT_EQ((*clip)->asset.vertex_count, baked_->asset.vertex_count);
  EXPECT_EQ((*clip)->name, "lab/ball");
  ClipSource source(*clip, 0, [] { return TimeUs{0}; });
  source.timeline()->set_interpolates(true);
  source.timeline()->seek(5 * kInterval / 2, 0);
  EXPECT_NEAR(source.poll({}).at(0).coefficients[0], 2.5, 1e-12);
}

TEST_F(RecordedClips, ASenderThatComesBackIsAPause) {
  write(true, own_asset());
  const auto clip = BakedClip::open(path_, "");
  ASSERT_TRUE(clip) << clip.error().message;
  ASSERT_EQ((*clip)->frames.size(), kPoses + 1u);
  EXPECT_EQ((*clip)->times_us.back(), (kPoses - 1) * kInterval + 5'000'000) << "of a minute";
  write(true, std::string(64, 'a'));
  EXPECT_EQ(BakedClip::open(path_, "").error().code, ErrorCode::kUnsupported);
}

/// A sender begins with a coarse basis and goes on in the whole one.
TEST_F(RecordedClips, AnotherBasisOfTheSurfaceGoesOn) {
  BakeOptions options;
  options.name = "ball";
  options.rank = 30;
  const BakeResult coarse = bake(make_icosphere(2), options, "").value();
  const BakeResult whole = std::move(*baked_);
  const auto record = [&](bool continues) {
    std::filesystem::remove(path_);
    auto writer = recording::Writer::create(path_, {"lab/ball", "test", 0}).value();
    const auto play = [&](const BakeResult& baked, int first, int last) {
      *baked_ = baked;
      layout_ = {CodecKind::kFloat64, baked.asset.rank, 3, baked.asset.band_ends};
      EXPECT_TRUE(writer.object(first * kInterval, baked.encoded.manifest.id.digest, baked.encoded.manifest.bytes));
      for (const AssetObject& chunk : baked.encoded.chunks)
        EXPECT_TRUE(writer.object(first * kInterval, chunk.id.digest, chunk.bytes));
      announce(writer, first * kInterval, own_asset(), continues && first > 0);
      for (int k = first; k < last; ++k) join(writer, k, k * kInterval, k * kInterval);
    };
    play(coarse, 0, 5);
    play(whole, 5, 9);
    EXPECT_TRUE(writer.finish());
  };
  record(true);
  const auto clip = BakedClip::open(path_, "");
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->asset.rank, whole.asset.rank);
  ASSERT_EQ((*clip)->frames.size(), 9u);
  for (std::size_t k = 0; k < 9; ++k) {
    ASSERT_EQ((*clip)->frames[k].size(), 3 * whole.asset.rank);
    EXPECT_NEAR((*clip)->frames[k][0], static_cast<double>(k), 1e-3) << "both have the same first column";
    EXPECT_EQ((*clip)->times_us[k], static_cast<TimeUs>(k) * kInterval);
  }
  record(false);
  EXPECT_EQ(BakedClip::open(path_, "").error().code, ErrorCode::kUnsupported);
}

TEST_F(RecordedClips, SurfacesComeFromTheCacheAsWell) {
  write(false);
  const std::string cache_dir = folder_.file("cache");
  EXPECT_EQ(BakedClip::open(path_, cache_dir).error().code, ErrorCode::kNotFound);
  const AssetCache cache(cache_dir);
  ASSERT_TRUE(cache.store(baked_->encoded.manifest.id, baked_->encoded.manifest.bytes));
  for (const AssetObject& chunk : baked_->encoded.chunks) ASSERT_TRUE(cache.store(chunk.id, chunk.bytes));
  const auto clip = BakedClip::open(path_, cache_dir);
  ASSERT_TRUE(clip) << clip.error().message;
  EXPECT_EQ((*clip)->asset_id, own_asset());
}

TEST_F(RecordedClips, HostileFilesAreErrors) {
  write(true);
  auto bytes = read_bytes(path_, 1 << 24).value();
  const std::size_t whole = bytes.size();
  for (std::size_t length = 0; length < whole; length += 1 + whole / 97) {
    const std::string cut = folder_.file("cut.ecrec");
    ASSERT_TRUE(
        write_file_atomically(cut, std::string(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length))));
    const auto clip = BakedClip::open(cut, "");
    EXPECT_LE(clip ? (*clip)->frames.size() : 0, static_cast<std::size_t>(kPoses)) << length;
  }
  for (std::size_t at = 0; at < whole; at += 1 + whole / 97) {
    bytes[at] ^= 0x55;
    ASSERT_TRUE(write_file_atomically(folder_.file("bad.ecrec"), std::string(bytes.begin(), bytes.end())));
    (void)BakedClip::open(folder_.file("bad.ecrec"), "");
    bytes[at] ^= 0x55;
  }
  EXPECT_FALSE(BakedClip::open(folder_.file("none.ecrec"), ""));
}

}  // namespace
}  // namespace eigencast
