// SPDX-License-Identifier: MIT
#include "sdk/send_policy.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace eigencast {
namespace {

constexpr TimeUs kFrameUs = 33'333;

/// Bytes of a frame whose motion needs `bits` at spacing 4 in four bands; each doubling of the spacing halves them.
std::size_t frame_bytes(const RateControl::Choice& choice, double bits) {
  return static_cast<std::size_t>(46 + bits / 8 * choice.bands / 4 * 4 / choice.half_spacing);
}

TEST(RateControl, SettlesAtItsTargetWithoutJumps) {
  RateControl control(30'000, 4, 4);
  double late_bits = 0;
  auto before = control.choice();
  for (int frame = 1; frame <= 600; ++frame) {
    const std::size_t bytes = frame_bytes(control.choice(), 3000);
    if (frame > 300) late_bits += static_cast<double>(bytes) * 8;
    control.add(bytes, frame * kFrameUs);
    EXPECT_LE(std::abs(control.choice().half_spacing - before.half_spacing), 1 + before.half_spacing / 4);
    before = control.choice();
  }
  EXPECT_NEAR(late_bits / (300 * kFrameUs * 1e-6), 30'000, 3'000);
  EXPECT_EQ(control.choice().bands, 4) << "the spacing alone was enough";
}

TEST(RateControl, SpacingIsNeverBelowTheErrorBound) {
  RateControl control(1e6, 6, 4);
  for (int frame = 1; frame <= 200; ++frame) control.add(50, frame * kFrameUs);
  EXPECT_EQ(control.choice(), (RateControl::Choice{6, 4}));
}

TEST(RateControl, DropsAndRestoresBands) {
  RateControl control(13'000, 4, 4);
  int frame = 1;
  for (; frame <= 600; ++frame) control.add(frame_bytes(control.choice(), 40'000), frame * kFrameUs);
  EXPECT_LT(control.choice().bands, 4);
  EXPECT_GE(control.choice().bands, 1);
  for (; frame <= 2000; ++frame) control.add(frame_bytes(control.choice(), 100), frame * kFrameUs);
  EXPECT_EQ(control.choice().bands, 4);
}

/// One band leaves room for another, which is then too much at any spacing.
TEST(RateControl, BandsReturnAfterEverLongerPauses) {
  RateControl control(14'400, 4, 4);
  std::vector<TimeUs> raised;
  double late_bits = 0;
  constexpr int kLongRun = 240 * 30;
  for (int frame = 1; frame <= kLongRun; ++frame) {
    const RateControl::Choice before = control.choice();
    const std::size_t bytes = 20u + 24u * before.bands + 60u / before.half_spacing;
    if (frame > kLongRun / 2) late_bits += static_cast<double>(bytes) * 8;
    control.add(bytes, frame * kFrameUs);
    if (control.choice().bands > before.bands) raised.push_back(frame * kFrameUs);
  }
  ASSERT_GE(raised.size(), 4u) << "it is tried";
  EXPECT_LE(raised.size(), 8u);
  EXPECT_GE(raised.back() - raised[raised.size() - 2], 30'000'000);
  EXPECT_NEAR(late_bits / (kLongRun / 2 * kFrameUs * 1e-6), 14'400, 0.05 * 14'400);
  for (int frame = kLongRun + 1; frame <= 3 * kLongRun; ++frame) control.add(30, frame * kFrameUs);
  EXPECT_EQ(control.choice().bands, 4) << "where there is room they all come back";
}

/// What a receiver knows at each time: it interpolates between held keys, or goes on along the last two.
struct TimedKey {
  TimeUs time;
  double value;
};

TEST(StillGate, InterpolationStaysWithinTheBound) {
  constexpr double kBound = 0.01;
  const auto truth = [](int frame) { return frame < 20 ? 0.1 * frame : frame < 60 ? 1.9 : 1.9 + 0.1 * (frame - 59); };
  StillGate gate(kBound, 1'000'000);
  std::vector<TimedKey> keys;
  for (int frame = 0; frame < 80; ++frame) {
    const TimeUs now = frame * kFrameUs;
    const double value = truth(frame);
    const auto action = keys.empty() ? StillGate::Action::kSend : gate.next(std::abs(value - keys.back().value), now);
    if (action == StillGate::Action::kHold) keys.push_back({now, keys.back().value});
    if (action == StillGate::Action::kResume) keys.push_back({gate.held_until_us(), keys.back().value});
    if (action == StillGate::Action::kSend || action == StillGate::Action::kResume) keys.push_back({now, value});
  }
  EXPECT_LT(keys.size(), 46u) << "the pause of 40 frames costs three keys: its first, a heartbeat, its last";
  for (std::size_t i = 1; i < keys.size(); ++i) ASSERT_GT(keys[i].time, keys[i - 1].time) << "times grow";
  for (int frame = 0; frame < 80; ++frame) {
    const TimeUs now = frame * kFrameUs;
    const auto after = std::find_if(keys.begin(), keys.end(), [now](const TimedKey& key) { return key.time >= now; });
    ASSERT_NE(after, keys.end());
    double shown = after->value;
    if (after->time > now) {
      const TimedKey& before = *(after - 1);
      const double u = static_cast<double>(now - before.time) / static_cast<double>(after->time - before.time);
      shown = before.value + u * (after->value - before.value);
    }
    EXPECT_NEAR(shown, truth(frame), kBound) << frame;
  }
}

TEST(StillGate, FirstStillPoseStopsExtrapolation) {
  StillGate gate(0.01, 1'000'000);
  EXPECT_EQ(gate.next(0.5, 1), StillGate::Action::kSend);
  EXPECT_EQ(gate.next(0.001, 2), StillGate::Action::kHold);
  EXPECT_EQ(gate.next(0.001, 3), StillGate::Action::kSkip);
  EXPECT_EQ(gate.next(0.001, 1'000'002), StillGate::Action::kHold) << "heartbeat";
  EXPECT_EQ(gate.next(0.5, 1'000'003), StillGate::Action::kSend) << "nothing was skipped since";
  EXPECT_EQ(gate.next(0.001, 1'000'004), StillGate::Action::kHold);
  EXPECT_EQ(gate.next(0.001, 1'000'005), StillGate::Action::kSkip);
  EXPECT_EQ(gate.next(0.5, 1'000'006), StillGate::Action::kResume);
  EXPECT_EQ(gate.held_until_us(), 1'000'005);
}

}  // namespace
}  // namespace eigencast
