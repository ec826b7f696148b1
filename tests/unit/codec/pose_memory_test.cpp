// SPDX-License-Identifier: MIT
#include "common/codec/pose_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>

#include "common/codec/band.h"
#include "common/codec/recaller.h"
#include "tests/support/paths.h"
#include "tests/unit/codec/motion_sample.h"

namespace eigencast {
namespace {

constexpr AssetDigest kAsset{1, 2, 3};
constexpr std::uint8_t kHalf = 6;

/// Keys of a sample motion at the times first, first + speed, ...
std::vector<Key> keys_of(const MotionSample& motion, double first, double speed, int count, std::uint8_t step = 158) {
  std::vector<Key> keys;
  for (int i = 0; i < count; ++i) keys.push_back(motion.key(first + speed * i, step));
  return keys;
}

/// A key of motion that the sample never makes.
Key unlike(Key key) {
  for (std::size_t i = 0; i < key.q.size(); ++i) key.q[i] *= static_cast<std::int32_t>(i * i % 7 % 3) - 1;
  return key;
}

CodedSegment segment_of(const CoefficientLayout& layout, const std::vector<Key>& keys) {
  return encode_segment(layout, kAsset, keys, remembered_half_spacing(kHalf)).value();
}

/// From a heap block of exactly the bytes, so that a sanitizer sees any read beyond them.
Result<std::shared_ptr<const MemorySegment>> decoded(const CoefficientLayout& layout, const Bytes& bytes) {
  const std::unique_ptr<std::uint8_t[]> exact(new std::uint8_t[bytes.size()]);
  std::copy(bytes.begin(), bytes.end(), exact.get());
  return decode_segment(layout, kAsset, ByteView(exact.get(), bytes.size()));
}

class PoseMemoryTest : public testing::Test {
 protected:
  CoefficientLayout layout = layout_of(CodecKind::kQuantised, 60);
  MotionSample motion{layout};
  CodedSegment coded = segment_of(layout, keys_of(motion, 0, 1, 40));
  PoseMemory memory = PoseMemory(layout).with(coded.segment).value();

  Result<RecalledKey> decode(const ChainState& state, BandMask bands, const Bytes& payload) const {
    const std::unique_ptr<std::uint8_t[]> exact(new std::uint8_t[payload.size()]);
    std::copy(payload.begin(), payload.end(), exact.get());
    return decode_recalled_key(layout, bands, state, memory, ByteView(exact.get(), payload.size()));
  }
  /// Two keys between poses of the memory, the newer one predicted from it.
  ChainState recalled_state() const {
    const ChainState before = advanced(std::nullopt, motion.key(5.3, 158), 0);
    const auto key = encode_recalled_key(layout, before, memory, 50, motion.key(6.3, 158), kHalf).value();
    return advanced(before, key.key, 33'333, key.phase);
  }
};

TEST_F(PoseMemoryTest, SegmentIsDecodedToWhatItsWriterHolds) {
  const auto segment = decoded(layout, coded.bytes);
  ASSERT_TRUE(segment) << segment.error().message;
  EXPECT_EQ((*segment)->values, coded.segment->values);
  EXPECT_EQ((*segment)->poses, 40u);
  EXPECT_EQ((*segment)->step, 158);
  const Key first = motion.key(0, 158);
  EXPECT_TRUE(std::equal(first.q.begin(), first.q.end(), memory.pose(0).begin())) << "the first is exact";
}

TEST_F(PoseMemoryTest, EveryTruncationAndExtraByteOfASegmentIsRejected) {
  for (std::size_t size = 0; size < coded.bytes.size(); ++size) {
    const auto cut =
        decoded(layout, Bytes(coded.bytes.begin(), coded.bytes.begin() + static_cast<std::ptrdiff_t>(size)));
    ASSERT_FALSE(cut) << size;
    EXPECT_TRUE(cut.error().code == ErrorCode::kCorrupt || cut.error().code == ErrorCode::kUnsupported) << size;
  }
  Bytes longer = coded.bytes;
  longer.push_back(0);
  EXPECT_EQ(decoded(layout, longer).error().code, ErrorCode::kCorrupt);
}

TEST_F(PoseMemoryTest, NoBitFlipOfASegmentCrashesOrLeavesTheRange) {
  const Bytes bytes = segment_of(layout, keys_of(motion, 0, 1, 3)).bytes;
  for (std::size_t bit = 0; bit < bytes.size() * 8; ++bit) {
    Bytes flipped = bytes;
    flipped[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
    const auto segment = decoded(layout, flipped);
    if (!segment) continue;
    EXPECT_EQ((*segment)->values.size(), (*segment)->poses * layout.size());
    for (const std::int32_t q : (*segment)->values) EXPECT_LE(std::abs(std::int64_t{q}), 1 << 30);
  }
}

TEST_F(PoseMemoryTest, SegmentOfAnotherSurfaceIsRejected) {
  EXPECT_EQ(decode_segment(layout, AssetDigest{1, 2, 4}, coded.bytes).error().code, ErrorCode::kCorrupt);
  for (const std::uint32_t rows : {59u, 61u, 14u})
    EXPECT_EQ(decoded(layout_of(CodecKind::kQuantised, rows), coded.bytes).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(decoded(layout_of(CodecKind::kQuantised, 60, 4), coded.bytes).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(decoded(layout_of(CodecKind::kFloat32), coded.bytes).error().code, ErrorCode::kInvalidArgument);
  Bytes newer = coded.bytes;
  newer[4] = 2;
  EXPECT_EQ(decoded(layout, newer).error().code, ErrorCode::kUnsupported);
}

TEST_F(PoseMemoryTest, SizesAreCheckedBeforeAnythingIsRead) {
  // The head of a segment and the number of its poses; then nothing.
  const auto claim = [](const CoefficientLayout& of, std::uint64_t poses) {
    const MotionSample sample(of);
    Bytes bytes = encode_segment(of, kAsset, keys_of(sample, 0, 1, 1), 3).value().bytes;
    std::size_t head = 4 + 1 + kAsset.size() + 2;
    for (const std::uint32_t end : of.band_ends) head += end < 128 ? 1 : 2;
    bytes.resize(head);
    ByteWriter(bytes).varint(poses);
    bytes.resize(bytes.size() + 4096, 0x9f);
    return decode_segment(of, kAsset, bytes).error().code;
  };
  const CoefficientLayout large = layout_of(CodecKind::kQuantised, 4096, 8);
  EXPECT_EQ(claim(layout, 1025), ErrorCode::kTooLarge);
  EXPECT_EQ(claim(layout, UINT64_MAX), ErrorCode::kTooLarge);
  EXPECT_EQ(claim(layout, 0), ErrorCode::kCorrupt);
  EXPECT_EQ(claim(large, 65), ErrorCode::kTooLarge) << "65 poses of 128 KiB";
  EXPECT_EQ(claim(large, 64), ErrorCode::kCorrupt) << "8 MiB are allowed, but are not there";
  EXPECT_EQ(encode_segment(layout, kAsset, std::vector<Key>(1025, motion.key(0, 158)), 3).error().code,
            ErrorCode::kTooLarge);
}

TEST_F(PoseMemoryTest, SegmentsAddUpToTheLimitOnly) {
  PoseMemory grown(layout);
  const auto segment = segment_of(layout, keys_of(motion, 0, 1, 128)).segment;
  for (int i = 0; i < 8; ++i) grown = grown.with(segment).value();
  EXPECT_EQ(grown.pose_count(), PoseMemory::kMaxPoses);
  EXPECT_EQ(grown.with(segment).error().code, ErrorCode::kTooLarge);
  EXPECT_TRUE(grown.has(8 * 127));
  EXPECT_FALSE(grown.has(8 * 127 + 1)) << "the last pose of a segment leads nowhere";
  EXPECT_TRUE(grown.has(8 * 1023));
  EXPECT_FALSE(grown.has(8 * 1024));
  EXPECT_FALSE(grown.has(UINT64_MAX));
}

TEST_F(PoseMemoryTest, PhasesLieOnTheCubicThroughFourPoses) {
  std::vector<std::int32_t> values(layout.size());
  for (const std::uint32_t phase : {0u, 3u, 8u, 77u, 8u * 38 + 5, 8u * 39}) {
    const std::uint32_t i = phase / 8;
    const double t = phase % 8 / 8.0;
    ASSERT_TRUE(memory.has(phase));
    ASSERT_TRUE(memory.recall(phase, 158, 0, values));
    for (std::size_t k = 0; k < values.size(); ++k) {
      const double a = memory.pose(i == 0 ? 0 : i - 1)[k], b = memory.pose(i)[k];
      const double c = memory.pose(std::min(i + 1, 39u))[k], d = memory.pose(std::min(i + 2, 39u))[k];
      const double exact = b + t / 2 * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)));
      ASSERT_EQ(values[k], std::floor(exact + 0.5)) << phase << " " << k;
    }
  }
  EXPECT_FALSE(memory.recall(0, 0, 0, values)) << "at a step so fine it leaves the range";
}

TEST_F(PoseMemoryTest, ReceiverHoldsTheSendersState) {
  Recaller sender(memory);
  ChainState held = advanced(std::nullopt, motion.key(3, 158), 0), receiver = held;
  int recalled = 0;
  for (int frame = 1; frame < 90; ++frame) {
    // The memory's motion, then new motion, then the memory's; changes of step.
    const double time = frame < 30 ? 3 + 0.87 * frame : frame < 40 ? 400 + frame : 0.6 * (frame - 40);
    const Key like = motion.key(time, static_cast<std::uint8_t>(158 + frame / 25));
    const Key target = frame < 30 || frame >= 40 ? like : unlike(like);
    const CodedKey key = sender.encode(held, target, kHalf).value();
    recalled += key.phase ? 1 : 0;
    Key got;
    if (key.phase) {
      const auto decoded = decode(receiver, layout.all_bands(), key.payload);
      ASSERT_TRUE(decoded) << decoded.error().message;
      EXPECT_EQ(decoded->phase, *key.phase);
      got = decoded->key;
    } else {
      got = decode_key(layout, layout.all_bands(), receiver, key.payload).value();
    }
    ASSERT_EQ(got, key.key) << frame;
    held = advanced(held, key.key, 33'333, key.phase);
    receiver = advanced(receiver, got, 33'333, key.phase);
    ASSERT_EQ(receiver, held);
    // One that joins here goes on as well as the others.
    receiver =
        decode_join(layout, layout.all_bands(), encode_join(layout, held).value(), held.phase.has_value()).value();
    receiver.age_us = held.age_us;
    ASSERT_EQ(receiver, held);
  }
  EXPECT_GT(recalled, 60);
  EXPECT_LT(recalled, 85);
}

TEST_F(PoseMemoryTest, BandsDecodeWithoutOthers) {
  const ChainState state = recalled_state();
  const CodedKey coded_key = encode_recalled_key(layout, state, memory, 59, motion.key(7.3, 158), kHalf).value();
  const Bytes join = encode_join(layout, state).value();
  const std::uint8_t all = layout.all_bands().bits;
  for (int mask = 1; mask <= all; ++mask) {
    const auto keep = static_cast<std::uint8_t>(mask);
    const Bytes short_join = cut_bands(layout, true, all, keep, join, true).value();
    const ChainState cut_state = decode_join(layout, keep, short_join, true).value();
    EXPECT_EQ(cut_state.phase, state.phase);
    const Bytes payload = cut_bands(layout, false, all, keep, coded_key.payload, true).value();
    const auto got = decode(cut_state, keep, payload);
    ASSERT_TRUE(got) << got.error().message;
    EXPECT_EQ(got->phase, 59u);
    for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
      const auto [first, last] = layout.range(band);
      for (std::size_t i = first; i < last; ++i)
        ASSERT_EQ(got->key.q[i], BandMask(keep).has(band) ? coded_key.key.q[i] : 0) << mask << " " << i;
    }
  }
}

TEST_F(PoseMemoryTest, HostileKeysAreRejected) {
  const ChainState state = recalled_state();
  const CodedKey key = encode_recalled_key(layout, state, memory, 59, motion.key(7.3, 158), kHalf).value();
  const BandMask all = layout.all_bands();
  for (std::size_t size = 0; size < key.payload.size(); ++size) {
    const Bytes cut(key.payload.begin(), key.payload.begin() + static_cast<std::ptrdiff_t>(size));
    ASSERT_FALSE(decode(state, all, cut)) << size;
    EXPECT_FALSE(cut_bands(layout, false, all, 1, cut, true)) << size;
  }
  Bytes longer = key.payload;
  longer.push_back(0);
  EXPECT_FALSE(decode(state, all, longer));
  for (std::size_t bit = 0; bit < key.payload.size() * 8; ++bit) {
    Bytes flipped = key.payload;
    flipped[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
    const auto got = decode(state, all, flipped);
    if (!got) continue;
    EXPECT_TRUE(memory.has(got->phase));
    for (const std::int32_t q : got->key.q) EXPECT_LE(std::abs(std::int64_t{q}), 1 << 30);
  }
  // Phases before the first and beyond the last: -51, 270 from 50, and those that wrap.
  for (const std::uint64_t code : {zigzag(-51), zigzag(270), zigzag(INT64_MAX), zigzag(INT64_MIN)}) {
    Bytes payload{key.payload[0]};
    ByteWriter(payload).varint(code);
    payload.insert(payload.end(), key.payload.begin() + 2, key.payload.end());
    const auto got = decode(state, all, payload);
    ASSERT_FALSE(got);
    EXPECT_EQ(got.error().code, ErrorCode::kCorrupt);
  }
  Bytes exact = key.payload;
  exact[0] &= 3;
  EXPECT_FALSE(decode(state, all, exact)) << "no spacing";
  ChainState far = state;
  far.phase = UINT32_MAX;
  Bytes join = encode_join(layout, far).value();
  EXPECT_EQ(decode_join(layout, all, join, true)->phase, UINT32_MAX);
  join[8] = 0x1f;  // The last of the phase's five bytes.
  EXPECT_FALSE(decode_join(layout, all, join, true));
  EXPECT_FALSE(decode_join(layout, all, join)) << "without the flag";
  ChainState elsewhere = state;
  elsewhere.phase = 8 * 40;
  EXPECT_FALSE(decode(elsewhere, all, key.payload)) << "a state of another memory";
  EXPECT_EQ(encode_recalled_key(layout, state, memory, 8 * 39 + 1, motion.key(7, 158), kHalf).error().code,
            ErrorCode::kInvalidArgument);
}

std::size_t bytes_of(const std::vector<Key>& keys, const PoseMemory& memory, std::size_t* recalled = nullptr) {
  Recaller sender(memory);
  std::size_t bytes = 0;
  ChainState state = advanced(std::nullopt, keys.front(), 0);
  for (std::size_t i = 1; i < keys.size(); ++i) {
    const CodedKey key = sender.encode(state, keys[i], kHalf).value();
    bytes += key.payload.size();
    if (recalled != nullptr) *recalled += key.phase ? 1 : 0;
    state = advanced(state, key.key, 33'333, key.phase);
  }
  return bytes;
}

TEST_F(PoseMemoryTest, MotionThatComesAgainTakesAFractionOfTheBits) {
  std::size_t recalled = 0;
  const auto again = keys_of(motion, 0.4, 0.87, 44);
  EXPECT_LT(3 * bytes_of(again, memory, &recalled), bytes_of(again, PoseMemory(layout)));
  EXPECT_EQ(recalled, 43u);
}

TEST_F(PoseMemoryTest, NewMotionTakesNoMoreBits) {
  std::vector<Key> keys = keys_of(motion, 1000, 1, 60);
  std::transform(keys.begin(), keys.end(), keys.begin(), unlike);
  const std::size_t plain = bytes_of(keys, PoseMemory(layout));
  EXPECT_LE(static_cast<double>(bytes_of(keys, memory)), 1.004 * static_cast<double>(plain));
}

TEST_F(PoseMemoryTest, WithoutAMemoryKeysAreAsEver) {
  for (const CodecKind codec : {CodecKind::kQuantised, CodecKind::kFloat32}) {
    const CoefficientLayout of = layout_of(codec);
    const MotionSample sample(of);
    Recaller sender{PoseMemory(of)};
    const Key key = sample.key(2, 150);
    EXPECT_EQ(sender.encode(sample.state(150), key, kHalf).value().payload,
              encode_key(of, sample.state(150), key, kHalf).value().payload);
  }
}

template <typename Values>
std::string array_of(const Values& values) {
  std::string out;
  for (const auto value : values) out += (out.empty() ? "" : ",") + std::to_string(value);
  return "[" + out + "]";
}

std::string hexadecimal(ByteView bytes) {
  std::string out;
  for (const std::uint8_t byte : bytes) out += {"0123456789abcdef"[byte >> 4], "0123456789abcdef"[byte & 15]};
  return out;
}

/// Segments and keys as tools/reference_memory.py must read them (tests/golden/README.md).
TEST(GoldenMemory, BytesAreWrittenAsEver) {
  const CoefficientLayout layout{CodecKind::kQuantised, 6, 3, {2, 4, 6}};
  // Integers, from no floating-point function.
  const auto pose = [&](int time, std::uint8_t step) {
    Key key = empty_key(layout, layout.all_bands(), step);
    for (std::size_t i = 0; i < key.q.size(); ++i) {
      const int n = static_cast<int>(i), around = (time + 3 * n) % 48 - 24;
      key.q[i] = (4000 >> (n / 3)) * (n % 5 - 2) + (24 - std::abs(around)) * (n * 11 % 7 - 3) * (8 - n / 3);
    }
    return key;
  };
  AssetDigest asset{};
  for (std::size_t i = 0; i < asset.size(); ++i) asset[i] = static_cast<std::uint8_t>(3 * i);
  std::string lines =
      "{\"format\":{\"rows\":6,\"channels\":3,\"band_ends\":[2,4,6],\"codec\":\"quantised\"},\"asset\":\"" +
      hexadecimal(asset) + "\"}\n";
  PoseMemory memory(layout);
  for (const int first : {0, 90}) {
    const auto step = static_cast<std::uint8_t>(first == 0 ? 120 : 117);
    std::vector<Key> poses;
    for (int time = first; time < first + 20; ++time) poses.push_back(pose(2 * time, step));
    const CodedSegment coded = encode_segment(layout, asset, poses, 2).value();
    lines += "{\"segment\":\"" + hexadecimal(coded.bytes) + "\",\"step\":" + std::to_string(step) + ",\"poses\":[";
    for (std::uint32_t i = 0; i < coded.segment->poses; ++i)
      lines +=
          (i == 0 ? "" : ",") + array_of(std::span(coded.segment->values).subspan(i * layout.size(), layout.size()));
    lines += "]}\n";
    memory = memory.with(decode_segment(layout, asset, coded.bytes).value()).value();
  }
  ChainState state = advanced(std::nullopt, pose(9, 120), 0);
  const auto add = [&](const char* kind, const Bytes& payload) {
    lines += "{\"" + std::string(kind) + "\":\"" + hexadecimal(payload) +
             "\",\"bands\":" + std::to_string(state.newer.bands.bits);
    if (state.phase) lines += ",\"phase\":" + std::to_string(*state.phase);
    lines += ",\"step\":" + std::to_string(state.newer.step) + ",\"values\":" + array_of(state.newer.q) + "}\n";
  };
  const auto add_join = [&] {
    const Bytes payload = encode_join(layout, state).value();
    ASSERT_TRUE(decode_join(layout, state.newer.bands, payload, state.phase.has_value()));
    add("join", payload);
  };
  add_join();
  for (int i = 0; i < 24; ++i) {
    Key key = pose(10 + i + i % 3, static_cast<std::uint8_t>(i < 18 ? 120 : 119));
    if (i == 7) key.q[4] = 1 << 30;
    if (i == 20) key.bands = 0b011, std::fill(key.q.begin() + 12, key.q.end(), 0);
    const auto m = static_cast<std::uint8_t>(1 + i % 7);
    const auto phase = static_cast<std::uint32_t>(40 + 4 * i + (i > 14 ? 100 : 0));
    const CodedKey coded = i % 8 == 5 ? encode_key(layout, state, key, m).value()
                                      : encode_recalled_key(layout, state, memory, phase, key, m).value();
    if (coded.phase) {
      const auto decoded_key = decode_recalled_key(layout, key.bands, state, memory, coded.payload);
      ASSERT_TRUE(decoded_key) << decoded_key.error().message;
      ASSERT_EQ(decoded_key->key, coded.key);
    }
    state = advanced(state, coded.key, 33'333, coded.phase);
    add("key", coded.payload);
    if (i % 10 == 9) add_join();
  }
  const std::string path = golden_dir() + "/memory.jsonl";
  if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) std::ofstream(path) << lines;
  std::stringstream held;
  held << std::ifstream(path).rdbuf();
  EXPECT_EQ(lines, held.str());
}

}  // namespace
}  // namespace eigencast
