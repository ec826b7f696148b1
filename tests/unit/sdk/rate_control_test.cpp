// SPDX-License-Identifier: MIT
// RateControl on what the codec makes of clips, without a network.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "common/codec/chain.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/surface/shapes/shapes.h"
#include "common/wire/envelope.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/send_policy.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

constexpr TimeUs kClipFrameUs = 33'333;
constexpr int kFrames = 600, kSettled = 180;  ///< Twenty seconds, of which six are for settling.

struct Coded {
  CoefficientLayout layout;
  Quantiser quantiser;
  std::vector<Key> keys;
};

Coded coded_of(const MotionClip& clip) {
  BakeOptions options;
  options.rank = 80;
  const auto baked = bake(clip.rest(), options);
  EXPECT_TRUE(baked) << baked.error().message;
  const Asset& asset = baked->asset;
  const auto projector = Projector::create(asset);
  EXPECT_TRUE(projector);
  Coded out{{CodecKind::kQuantised, asset.rank, 3, asset.band_ends},
            quantiser_for_error(kDefaultErrorOverDiagonal * asset.diagonal(), asset.area, asset.rank),
            {}};
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const auto pose = clip.pose(frame);
    EXPECT_TRUE(pose);
    std::vector<double> flat;
    for (const Vec3& vertex : *pose) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto C = projector->coefficients_from_positions(std::span<const double>(flat));
    out.keys.push_back(*key_from_coefficients(out.layout, *C, out.quantiser.step));
  }
  return out;
}

struct Run {
  double bits_per_s = 0;  ///< After it has settled.
  int min_bands = 8;
  std::vector<double> octaves;  ///< log2 of the half spacing, after it has settled.
};

/// The clip to and fro; without a target, as the error bound takes.
Run play(const Coded& clip, std::optional<double> target) {
  std::optional<RateControl> control;
  const auto bands = static_cast<std::uint8_t>(clip.layout.band_ends.size());
  if (target) control.emplace(*target, clip.quantiser.half_spacing, bands);
  std::optional<ChainState> state;
  Run run;
  double bytes = 0;
  for (int frame = 0; frame < kFrames; ++frame) {
    const auto period = static_cast<int>(2 * clip.keys.size() - 2);
    const int at = std::min(frame % period, period - frame % period);
    const auto choice = control ? control->choice() : RateControl::Choice{clip.quantiser.half_spacing, bands};
    const Key key = lowest_bands(clip.layout, clip.keys[static_cast<std::size_t>(at)], choice.bands);
    std::size_t size = Envelope::kKeyBytes;
    if (state) {
      auto coded = encode_key(clip.layout, *state, key, choice.half_spacing);
      EXPECT_TRUE(coded);
      size += coded->payload.size();
      state = advanced(state, std::move(coded->key), kClipFrameUs);
    } else {
      state = advanced(std::nullopt, key, 0);
      size += encode_join(clip.layout, *state)->size();
    }
    if (control) control->add(size, (frame + 1) * kClipFrameUs);
    if (frame < kSettled) continue;
    bytes += static_cast<double>(size);
    run.min_bands = std::min(run.min_bands, int{choice.bands});
    run.octaves.push_back(std::log2(choice.half_spacing));
  }
  run.bits_per_s = bytes * 8 / ((kFrames - kSettled) * kClipFrameUs * 1e-6);
  return run;
}

void check(const MotionClip& clip) {
  const Coded coded = coded_of(clip);
  const double free = play(coded, std::nullopt).bits_per_s;
  constexpr double kEnvelopes = Envelope::kKeyBytes * 8 / (kClipFrameUs * 1e-6);
  for (const double share : {0.9, 0.75, 0.6}) {
    const double target = kEnvelopes + share * (free - kEnvelopes);
    const Run run = play(coded, target);
    EXPECT_NEAR(run.bits_per_s, target, 0.05 * target) << clip.name() << " at " << share;
    double move = 0;
    for (std::size_t i = 1; i < run.octaves.size(); ++i) move += std::abs(run.octaves[i] - run.octaves[i - 1]);
    EXPECT_LT(move / (static_cast<double>(run.octaves.size()) * kClipFrameUs * 1e-6), 2.0)
        << clip.name() << " at " << share << ": octaves of spacing wandered a second";
  }
  EXPECT_NEAR(play(coded, 3 * free).bits_per_s, free, 0.001 * free) << "there is room: nothing changes";
}

TEST(RateControl, BuiltInClipKeepsItsRate) {
  check(**builtin_clip("bar:twist"));
}

TEST(RateControl, RealClipKeepsItsRate) {
  check(**open_clip(gait_clip().string()));
}

}  // namespace
}  // namespace eigencast
