// SPDX-License-Identifier: MIT
//
// Frames of known bytes and what they decode to, in tests/golden (see its README). The encoder must write these bytes,
// the decoder must read these numbers; tools/reference_decoder.py is held to the same files.
#include <gtest/gtest.h>

#include <charconv>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "common/codec/chain.h"
#include "common/codec/key.h"
#include "common/codec/pose_memory.h"
#include "common/wire/envelope.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

/// A decoded pose of a coefficient or two as JSON; doubles are chosen so that their shortest form has no exponent.
template <typename T>
std::string json_array(const std::vector<T>& values) {
  std::string out = "[";
  for (const T& value : values) {
    char text[32];
    const auto end = std::to_chars(text, text + sizeof text, value).ptr;
    if (out.size() > 1) out += ',';
    out.append(text, end);
  }
  return out + "]";
}

std::string json_of(const CoefficientLayout& layout, const Key& key) {
  return "{\"bands\":" + std::to_string(key.bands.bits) + ",\"step\":" + std::to_string(key.step) +
         ",\"values\":" + (layout.codec == CodecKind::kQuantised ? json_array(key.q) : json_array(key.f)) + "}";
}

std::string hex_of(const Bytes& bytes) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string out;
  for (const std::uint8_t byte : bytes) {
    out += kDigits[byte >> 4];
    out += kDigits[byte & 15];
  }
  return out;
}

/// Writes a stream frame by frame as a sender or broker would, and reads each as a receiver would.
class Stream {
 public:
  explicit Stream(CoefficientLayout layout, const std::string& more = {}, const VelocityChannels& velocities = {})
      : layout_(std::move(layout)), velocities_(velocities) {
    frames_ = "format {\"rows\":" + std::to_string(layout_.rows) + ",\"channels\":" + std::to_string(layout_.channels) +
              ",\"band_ends\":" + json_array(layout_.band_ends) + ",\"codec\":\"" +
              std::string(name_of(layout_.codec)) + "\"" + more + "}\n";
  }

  /// Begins with a memory of these poses, in segments of four. REQUIRES: nothing was written.
  void remember(const std::vector<Key>& poses) {
    constexpr AssetDigest kAsset{0xa5, 7};
    memory_.emplace(layout_);
    std::string hex;
    for (std::size_t i = 0; i < poses.size(); i += 4) {
      const auto coded = encode_segment(layout_, kAsset, std::span(poses).subspan(i, 4), 3).value();
      memory_ = memory_->with(decode_segment(layout_, kAsset, coded.bytes).value()).value();
      hex += (hex.empty() ? "\"" : ",\"") + hex_of(coded.bytes) + "\"";
    }
    frames_.resize(frames_.size() - 2);
    const std::string asset = hex_of({kAsset.begin(), kAsset.end()});
    frames_ += ",\"memory\":{\"asset\":\"" + asset + "\",\"segments\":[" + hex + "]}}\n";
  }

  /// Integers that fall off with the row and move unevenly, from no floating-point function.
  Key pose(int time, std::uint8_t step) const {
    Key key;
    key.bands = layout_.all_bands();
    key.step = layout_.codec == CodecKind::kQuantised ? step : 0;
    for (std::size_t i = 0; i < layout_.size(); ++i) {
      const int row = static_cast<int>(i / layout_.channels);
      const int n = static_cast<int>(i);
      const int value = (2000 >> row) * ((n * 7 + 3) % 5 - 2) + time * ((n * 11) % 7 - 3) * (8 - row) +
                        (time * time * (n % 3) + n) % 4;
      if (layout_.codec == CodecKind::kQuantised) {
        key.q.push_back(value);
      } else {
        key.f.push_back(value + 0.25);
      }
    }
    return key;
  }

  /// `ahead`: what it shows; {0, 0}: nothing.
  void join(std::optional<InterpolationStep> ahead = {}) {
    const Bytes payload = encode_join(layout_, *sender_).value();
    const auto bands = sender_->newer.bands;
    const auto decoded = decode_join(layout_, bands, payload, sender_->phase.has_value());
    ASSERT_TRUE(decoded) << decoded.error().message;
    ASSERT_EQ(decoded->phase, sender_->phase);
    receiver_ = *decoded;
    receiver_->age_us = sender_->age_us;
    write_key(FrameKind::kJoin, bands, ahead, payload,
              ",\"age_us\":" + std::to_string(sender_->age_us) + ",\"older\":" + json_of(layout_, decoded->older) +
                  ",\"newer\":" + json_of(layout_, decoded->newer));
  }
  void first(const Key& key) {
    sender_ = advanced(std::nullopt, key, 0);
    join();
  }
  void key(const Key& key, std::uint8_t half_spacing, std::uint8_t keep = 255,
           std::optional<InterpolationStep> ahead = {}, std::optional<std::uint32_t> at = {}) {
    ++sequence_;
    auto [payload, coded, phase] = (at ? encode_recalled_key(layout_, *sender_, *memory_, *at, key, half_spacing)
                                       : encode_key(layout_, *sender_, key, half_spacing))
                                       .value();
    ASSERT_EQ(phase, at);
    const BandMask bands = key.bands & keep;
    if (bands != key.bands) payload = cut_bands(layout_, false, key.bands, keep, payload, at.has_value()).value();
    const auto decoded = [&]() -> Result<Key> {
      if (!at) return decode_key(layout_, bands, *receiver_, payload);
      auto recalled = decode_recalled_key(layout_, bands, *receiver_, *memory_, payload);
      return recalled ? Result<Key>(recalled->key) : recalled.error();
    }();
    ASSERT_TRUE(decoded) << decoded.error().message;
    if (bands == key.bands) {
      ASSERT_EQ(*decoded, coded);
    }
    receiver_ = advanced(receiver_, *decoded, 30'000, phase);
    sender_ = advanced(sender_, *decoded, 30'000, phase);
    write_key(FrameKind::kKey, bands, ahead, payload, ",\"pose\":" + json_of(layout_, *decoded));
  }
  void step(std::uint8_t at, std::uint8_t of) {
    write({FrameKind::kStep, 0, 0, {at, of}, 7, 3, sequence_, capture(at, of), 200}, {},
          ",\"pose\":" + json_of(layout_, made(at, of)));
  }
  /// The pose is `away` from the one between the keys, further by one from value to value of `bands`.
  void residual(std::uint8_t at, std::uint8_t of, BandMask bands, std::int32_t away, std::uint8_t half_spacing) {
    const Key base = made(at, of);
    Key pose = base;
    for (std::size_t band = 0; band < layout_.band_ends.size(); ++band) {
      const auto [first, last] = layout_.range(band);
      for (std::size_t i = first; bands.has(band) && i < last; ++i) {
        if (layout_.is_float()) pose.f[i] += away;
        if (!layout_.is_float()) pose.q[i] += pose.q[i] > 0 ? -away - static_cast<int>(i) : away;
      }
    }
    const auto [coded, payload] = encode_residual(layout_, base, pose, half_spacing).value();
    ASSERT_EQ(coded, bands);
    const auto decoded = decode_residual(layout_, coded, base, payload);
    ASSERT_TRUE(decoded) << decoded.error().message;
    for (std::size_t i = 0; i < pose.q.size(); ++i) ASSERT_LE(std::abs(decoded->q[i] - pose.q[i]), half_spacing);
    ASSERT_EQ(decoded->f, pose.f);
    write({FrameKind::kStep, 0, coded, {at, of}, 7, 3, sequence_, capture(at, of), 200}, payload,
          ",\"pose\":" + json_of(layout_, *decoded));
  }
  void estimate(bool damped, std::uint8_t at, std::uint8_t of) {
    const Key pose = estimate_keys(layout_, receiver_->older, receiver_->newer, damped, at, of).value();
    write({FrameKind::kEstimate, 0, {}, {at, of}, 7, 3, sequence_, capture(of + at, of), 200}, {},
          ",\"pose\":" + json_of(layout_, pose));
  }

  /// Compares with tests/golden, or writes there when EIGENCAST_WRITE_GOLDEN is set.
  void check(const std::string& name) const {
    const std::string base = golden_dir() + "/" + name;
    for (const auto& [path, text] : {std::pair{base + ".frames", frames_}, std::pair{base + ".jsonl", poses_}}) {
      if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) std::ofstream(path) << text;
      std::ifstream file(path);
      std::stringstream golden;
      golden << file.rdbuf();
      EXPECT_EQ(golden.str(), text) << path;
    }
  }

 private:
  TimeUs capture(int at, int of) const {
    return 1'000'000 + static_cast<TimeUs>(sequence_) * 30'000 - 30'000 + 30'000 * at / of;
  }

  Key made(std::uint8_t at, std::uint8_t of) const {
    const auto& [older, newer, age_us, phase] = *receiver_;
    return hermite_keys(layout_, velocities_, older, newer, age_us, at, of).value();
  }

  void write_key(FrameKind kind, BandMask bands, std::optional<InterpolationStep> ahead, const Bytes& payload,
                 std::string decoded) {
    const InterpolationStep step = ahead.value_or(InterpolationStep{});
    if (step.of != 0) decoded += ",\"shown\":" + json_of(layout_, made(step.at, step.of));
    const auto flags =
        static_cast<std::uint8_t>((ahead ? Envelope::kAhead : 0) | (receiver_->phase ? Envelope::kRecalled : 0));
    write({kind, flags, bands, step, 7, 3, sequence_, capture(3, 3), 200, receiver_->age_us}, payload, decoded);
  }

  void write(const Envelope& envelope, const Bytes& payload, const std::string& decoded) {
    Bytes frame;
    append_envelope(envelope, newest_ ? &*newest_ : nullptr, frame);
    frame.insert(frame.end(), payload.begin(), payload.end());
    const auto parsed = parse_frame(frame);
    ASSERT_TRUE(parsed) << parsed.error().message;
    const auto read = resolved(*parsed, newest_ ? &*newest_ : nullptr, 3);
    ASSERT_TRUE(read);
    ASSERT_EQ(read->envelope, envelope);
    if (envelope.is_key()) newest_ = ChainClock::after(envelope);
    frames_ += hex_of(frame) + "\n";
    constexpr const char* kNames[] = {"", "key", "join", "step", "estimate"};
    poses_ += std::string("{\"kind\":\"") + kNames[static_cast<int>(envelope.kind)] +
              "\",\"flags\":" + std::to_string(envelope.flags) + ",\"bands\":" + std::to_string(envelope.bands.bits) +
              ",\"at\":" + std::to_string(envelope.step.at) + ",\"of\":" + std::to_string(envelope.step.of) +
              ",\"stream_id\":7,\"tag\":200,\"sequence\":" + std::to_string(envelope.sequence) +
              ",\"capture_us\":" + std::to_string(envelope.capture_us) + decoded + "}\n";
  }

  CoefficientLayout layout_;
  VelocityChannels velocities_;
  std::optional<PoseMemory> memory_;
  std::optional<ChainState> sender_, receiver_;
  std::optional<ChainClock> newest_;
  std::uint64_t sequence_ = 1;
  std::string frames_, poses_;
};

const std::vector<std::uint32_t> kGoldenBandEnds = {2, 4, 6};

TEST(Golden, KeysAndJoins) {
  Stream stream({CodecKind::kQuantised, 6, 3, kGoldenBandEnds});
  stream.first(stream.pose(0, 120));
  stream.key(stream.pose(1, 120), 4);
  stream.key(stream.pose(2, 120), 5);
  stream.join();
  stream.key(stream.pose(3, 117), 1);
  stream.key(stream.pose(4, 130), 0);
  stream.join();
  Key extreme = stream.pose(5, 130);
  extreme.q[4] = 1 << 30;
  extreme.q[17] = -(1 << 30);
  stream.key(extreme, 2);
  stream.key(stream.pose(6, 130), 2, 0b011);
  stream.key(stream.pose(7, 130), 3, 0b001);
  stream.join();
  stream.key(stream.pose(8, 130), 3);
  stream.join();
  for (int time = 9; time < 30; ++time) stream.key(stream.pose(time, 130), static_cast<std::uint8_t>(1 + time % 5));
  stream.key(stream.pose(29, 130), 63);
  stream.check("quantised-keys");
}

TEST(Golden, StepsAndResiduals) {
  constexpr InterpolationStep kFirst{1, 3}, kNone{};
  Stream stream({CodecKind::kQuantised, 6, 3, kGoldenBandEnds});
  stream.first(stream.pose(0, 120));
  for (int time = 1; time < 4; ++time) {
    stream.key(stream.pose(time, time == 3 ? 123 : 120), 4, 255, kFirst);
    for (std::uint8_t at = 2; at <= 3; ++at) stream.step(at, 3);
  }
  stream.key(stream.pose(4, 123), 4, 255, kNone);
  stream.residual(1, 3, 0b101, 40, 3);
  stream.residual(2, 3, 0b010, 1'000'000, 63);
  stream.join(kNone);
  stream.residual(1, 2, 0b111, 5, 0);
  stream.join(InterpolationStep{7, 15});
  Key extreme = stream.pose(5, 123);
  extreme.q[4] = 1 << 30;
  extreme.q[17] = -(1 << 30);
  stream.key(extreme, 0, 0b101, InterpolationStep{14, 15});
  stream.residual(15, 15, 0b001, 30, 20);
  stream.step(15, 15);
  stream.check("quantised-steps");
}

TEST(Golden, KeysOfAMemory) {
  constexpr InterpolationStep kFirst{1, 3}, kNone{};
  Stream stream({CodecKind::kQuantised, 6, 3, kGoldenBandEnds});
  std::vector<Key> poses;
  for (int time = 0; time < 12; ++time) poses.push_back(stream.pose(time, 120));
  stream.remember(poses);
  stream.first(stream.pose(0, 120));
  stream.key(stream.pose(1, 120), 4, 255, {}, 8);
  stream.key(stream.pose(2, 120), 5, 255, kFirst, 19);
  for (std::uint8_t at = 2; at <= 3; ++at) stream.step(at, 3);
  stream.join();
  stream.key(stream.pose(2, 120), 5, 0b011, kNone, 20);
  stream.residual(1, 3, 0b010, 40, 3);
  stream.join(InterpolationStep{1, 2});
  stream.key(stream.pose(4, 120), 4);
  stream.join();
  stream.key(stream.pose(5, 117), 63, 255, {}, 40);
  stream.key(stream.pose(11, 117), 1, 255, {}, 88);
  stream.estimate(false, 1, 3);
  Key extreme = stream.pose(5, 117);
  extreme.q[4] = 1 << 30;
  stream.key(extreme, 2, 0b101, {}, 0);
  stream.join();
  for (int time = 3; time < 10; ++time)
    stream.key(stream.pose(time, 120), 4, 255, {},
               static_cast<std::uint32_t>(time == 6 ? 32 : 8 * time + (time % 4 == 3 ? 0 : 3)));
  stream.check("quantised-memory");
}

TEST(Golden, HermiteAndEstimateFrames) {
  // Channels 2 and 3 are the velocities of 0 and 1.
  Stream hermite({CodecKind::kQuantised, 6, 4, kGoldenBandEnds},
                 ",\"velocity_channels\":2,\"velocity_us\":12500,\"scheme\":\"hermite\"", {2, 12'500});
  hermite.first(hermite.pose(0, 120));
  for (int time = 1; time < 4; ++time) {
    hermite.key(hermite.pose(time, time == 3 ? 123 : 120), 0, 255, InterpolationStep{1, 5});
    for (std::uint8_t at = 2; at < 5; ++at) hermite.step(at, 5);
  }
  hermite.residual(2, 5, 0b011, 9, 2);
  hermite.check("quantised-hermite");
  for (const bool damped : {false, true}) {
    const std::string scheme = damped ? "damped" : "linear";
    Stream stream({CodecKind::kQuantised, 6, 3, kGoldenBandEnds}, ",\"scheme\":\"" + scheme + "\"");
    stream.first(stream.pose(0, 120));
    for (int time = 1; time < 4; ++time) {
      stream.key(stream.pose(time, time == 3 ? 117 : 120), 0, time == 2 ? 0b011 : 255);
      for (std::uint8_t at = 1; at <= 15; at += 2) stream.estimate(damped, at, 4);
    }
    stream.check("quantised-estimated-" + scheme);
  }
}

TEST(Golden, FloatCodecFrames) {
  for (const CodecKind codec : {CodecKind::kFloat32, CodecKind::kFloat64}) {
    Stream stream({codec, 2, 2, {1, 2}});
    stream.first(stream.pose(0, 0));
    stream.key(stream.pose(1, 0), 0);
    stream.key(stream.pose(2, 0), 0, 255, InterpolationStep{});
    stream.residual(1, 2, 0b10, 3, 0);
    stream.key(stream.pose(3, 0), 0, 0b01);
    stream.join();
    stream.check(std::string(name_of(codec)));
  }
}

}  // namespace
}  // namespace eigencast
