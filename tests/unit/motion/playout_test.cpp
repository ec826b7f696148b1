// SPDX-License-Identifier: MIT
#include "common/motion/playout.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/unit/motion/support.h"

namespace eigencast {
namespace {

constexpr TimeUs kPlayoutInterval = 40 * kMs;
constexpr TimeUs kPlayoutZero = 5'000'000'000;

// The pose's one coefficient is its media time in seconds.
PlayoutPose pose_at(TimeUs media_us) {
  return {media_us, {static_cast<double>(media_us - kPlayoutZero) * 1e-6}};
}

Playout player(PlayoutMode mode, TimeUs delay_us = 0, TimeUs max_ahead_us = 200'000) {
  PlayoutSettings settings;
  settings.mode = mode;
  settings.delay_us = delay_us;
  settings.max_ahead_us = max_ahead_us;
  return Playout(settings);
}

// Shows 60 pictures a second while poses come; calls show(now, pose) for each.
template <typename DelayOf, typename Show>
void play(Playout& playout, int poses, DelayOf delay_of, double drift, Show show) {
  TimeUs now_us = 0, last_us = 0;
  for (int i = 0; i < poses; ++i) {
    const TimeUs made_us = i * kPlayoutInterval;
    last_us = std::max(last_us, made_us + delay_of(i));
    for (; now_us < last_us; now_us += 16'667) {
      if (const auto pose = playout.at(now_us)) show(now_us, *pose);
    }
    const auto media_us = kPlayoutZero + static_cast<TimeUs>(static_cast<double>(made_us) * (1 + drift));
    ASSERT_TRUE(playout.add(pose_at(media_us), last_us));
  }
}

TEST(Playout, ShowsNothingBeforeTheFirstPose) {
  for (const auto mode : {PlayoutMode::kLatest, PlayoutMode::kInterpolate, PlayoutMode::kEstimate}) {
    Playout playout = player(mode);
    EXPECT_FALSE(playout.at(0));
    playout.add(pose_at(kPlayoutZero), 0);
    EXPECT_TRUE(playout.at(0));
    playout.reset();
    EXPECT_FALSE(playout.at(0));
  }
}

TEST(Playout, ViewersOfOneLagShowTheSameMoment) {
  constexpr TimeUs kLag = 200 * kMs - kPlayoutZero;
  Playout near = player(PlayoutMode::kInterpolate), far = player(PlayoutMode::kInterpolate);
  EXPECT_FALSE(near.needed_lag_us());
  for (Playout* playout : {&near, &far}) playout->set_lag(kLag);
  const auto exact = [](TimeUs now_us, const PlayoutPose& pose) {
    if (now_us > 300 * kMs) {
      EXPECT_EQ(pose.time_us, now_us - kLag);
    }
  };
  play(
      near, 100, [](int) { return 10 * kMs; }, 0, exact);
  play(
      far, 100, [](int i) { return (90 + i % 3 * 20) * kMs; }, 0, exact);
  EXPECT_EQ(near.needed_lag_us(), 10 * kMs - kPlayoutZero + kPlayoutInterval);
  EXPECT_EQ(far.needed_lag_us(), 130 * kMs - kPlayoutZero + kPlayoutInterval);
  EXPECT_EQ(near.delay_us(), 190 * kMs);
  near.set_lag({});
  EXPECT_EQ(near.delay_us(), kPlayoutInterval);
}

TEST(Playout, LatePosesAreRefused) {
  Playout playout = player(PlayoutMode::kLatest);
  EXPECT_TRUE(playout.add(pose_at(1000), 0));
  EXPECT_FALSE(playout.add(pose_at(1000), 1));
  EXPECT_FALSE(playout.add(pose_at(999), 2));
  EXPECT_EQ(playout.at(3)->time_us, 1000);
}

TEST(Playout, LatestShowsTheNewestAsItIs) {
  Playout playout = player(PlayoutMode::kLatest);
  playout.add(pose_at(0), 0);
  playout.add(pose_at(kPlayoutInterval), 200 * kMs);
  EXPECT_EQ(playout.at(200 * kMs)->coefficients, pose_at(kPlayoutInterval).coefficients);
}

TEST(Playout, MovesTowardsAKeyThatCameAhead) {
  const auto at = [](TimeUs media_us, double value) { return PlayoutPose{kPlayoutZero + media_us, {value}}; };
  for (const auto mode : {PlayoutMode::kLatest, PlayoutMode::kInterpolate, PlayoutMode::kEstimate}) {
    Playout playout = player(mode, 10 * kMs);
    const bool latest = mode == PlayoutMode::kLatest;
    const auto shown = [&](TimeUs now_us) { return playout.at(now_us)->coefficients[0]; };
    playout.add_next(at(20 * kMs, 9));  // No pose yet: dropped.
    playout.add(at(0, 0), 100 * kMs);
    playout.add(at(40 * kMs, 0.4), 140 * kMs);
    EXPECT_NEAR(shown(150 * kMs), 0.4, 1e-9);
    playout.add_next(at(80 * kMs, 0.8));
    EXPECT_NEAR(shown(170 * kMs), latest ? 0.4 : 0.6, 1e-9);
    EXPECT_TRUE(playout.add(at(70 * kMs, 0.7), 170 * kMs)) << "a pose on the way to it";
    EXPECT_FALSE(playout.add(at(69 * kMs, 7), 171 * kMs));
    EXPECT_NEAR(shown(185 * kMs), latest ? 0.7 : 0.75, 1e-9);
    EXPECT_TRUE(playout.add(at(80 * kMs, 0.8), 186 * kMs)) << "the key itself";
    EXPECT_FALSE(playout.add(at(80 * kMs, 0.8), 187 * kMs));
    const double beyond = shown(200 * kMs);
    EXPECT_TRUE(mode == PlayoutMode::kEstimate ? beyond > 0.81 : std::abs(beyond - 0.8) < 1e-9) << beyond;
    playout.add_next(at(120 * kMs, 1.2));
    EXPECT_TRUE(playout.add(at(130 * kMs, 1.3), 230 * kMs)) << "the poses up to the key were lost";
    EXPECT_FALSE(playout.add(at(125 * kMs, 1.2), 231 * kMs));
  }
}

TEST(Playout, MovesEvenlyUnderJitter) {
  std::mt19937 random(2);
  std::uniform_int_distribution<TimeUs> jitter(0, 30 * kMs);
  Playout playout = player(PlayoutMode::kInterpolate);
  TimeUs shown_us = 0;
  TimeUs before_us = std::numeric_limits<TimeUs>::min();
  int uneven = 0, pictures = 0;
  play(
      playout, 1000, [&](int) { return 10 * kMs + jitter(random); }, 0,
      [&](TimeUs now_us, const PlayoutPose& pose) {
        EXPECT_GE(pose.time_us, before_us) << "media time ran back";
        if (!pose.settling) {
          EXPECT_NEAR(pose.coefficients[0], static_cast<double>(pose.time_us - kPlayoutZero) * 1e-6, 1e-9);
        }
        if (now_us > 2'000 * kMs) {
          ++pictures;
          const double step = static_cast<double>(pose.time_us - before_us) / static_cast<double>(now_us - shown_us);
          if (std::abs(step - 1) > 0.06) ++uneven;
          // The delay that was promised: way, jitter, one interval.
          EXPECT_LT(now_us - (pose.time_us - kPlayoutZero), 10 * kMs + 30 * kMs + kPlayoutInterval + 5 * kMs);
        }
        before_us = pose.time_us;
        shown_us = now_us;
      });
  EXPECT_LT(uneven, pictures / 20);
}

TEST(Playout, FollowsDriftingClocks) {
  for (const double drift : {-5e-4, 5e-4}) {
    Playout playout = player(PlayoutMode::kInterpolate, 60 * kMs);
    TimeUs before_us = std::numeric_limits<TimeUs>::min();
    play(
        playout, 7500, [](int) { return 10 * kMs; }, drift,
        [&](TimeUs now_us, const PlayoutPose& pose) {
          EXPECT_GE(pose.time_us, before_us);
          before_us = pose.time_us;
          // Five minutes, 150 ms of drift: the delay in true time stays what it was.
          const double made_us = static_cast<double>(pose.time_us - kPlayoutZero) / (1 + drift);
          if (now_us > 200 * kMs) {
            EXPECT_NEAR(static_cast<double>(now_us) - made_us, 70 * kMs, 4 * kMs);
          }
        });
  }
}

TEST(Playout, EstimatesAreDampedAndLimited) {
  Playout playout = player(PlayoutMode::kEstimate, 0, 100 * kMs);
  playout.add(pose_at(kPlayoutZero), 10 * kMs);
  Playout undirected = playout;
  const auto first = undirected.at(20 * kMs);
  EXPECT_EQ(first->time_us, kPlayoutZero) << "one pose has no direction";
  EXPECT_EQ(first->shown, Shown::kHeld);
  playout.add(pose_at(kPlayoutZero + kPlayoutInterval), 10 * kMs + kPlayoutInterval);
  const auto ahead = playout.at(10 * kMs + 2 * kPlayoutInterval);
  EXPECT_EQ(ahead->time_us, kPlayoutZero + 2 * kPlayoutInterval) << "nothing is held";
  EXPECT_NEAR(ahead->coefficients[0], 0.040 + 0.040 * Playout::kDamping, 1e-12);
  EXPECT_EQ(ahead->shown, Shown::kEstimated);
  const auto held = playout.at(900 * kMs);
  EXPECT_EQ(held->time_us, kPlayoutZero + kPlayoutInterval + 100 * kMs);
  const double d = Playout::kDamping;
  EXPECT_NEAR(held->coefficients[0], 0.040 * (1 + d + d * d + d * d * d / 2), 1e-12);
  EXPECT_EQ(held->shown, Shown::kHeld);
  EXPECT_EQ(playout.at(1900 * kMs)->coefficients, held->coefficients);
}

TEST(Playout, WrongEstimateIsCorrectedWithBoundedVelocity) {
  // Even motion that stops: the overshoot must be corrected.
  for (const auto mode : {PlayoutMode::kEstimate, PlayoutMode::kInterpolate}) {
    Playout playout = player(mode);
    const double per_ms = 0.001;  // The motion's speed, in the pose's units.
    const auto truth = [&](TimeUs t_us) { return per_ms * static_cast<double>(std::min(t_us, 2'000 * kMs) / kMs); };
    double shown = 0, max_wrong = 0;
    bool settled = false;
    for (TimeUs now_us = 0; now_us < 4'000 * kMs; now_us += 10 * kMs) {
      const bool stalls = now_us >= 1'000 * kMs && now_us < 1'300 * kMs;  // Then its keys come all at once.
      if (now_us % kPlayoutInterval == 0 && !stalls) {
        for (TimeUs t = now_us == 1'320 * kMs ? 1'000 * kMs : now_us; t <= now_us; t += kPlayoutInterval)
          playout.add({kPlayoutZero + t, {truth(t)}}, now_us);
      }
      const auto pose = playout.at(now_us);
      ASSERT_TRUE(pose);
      if (now_us > 200 * kMs) {
        // The motion, 5 % of the clock's, and an error of at most 320 ms of motion that fades in 150 ms.
        const double allowed = 10 * per_ms * 1.05 + 10.0 / 150 * 320 * per_ms;
        EXPECT_LE(std::abs(pose->coefficients[0] - shown), allowed) << now_us;
      }
      settled = settled || pose->settling;
      shown = pose->coefficients[0];
      if (now_us > 2'600 * kMs) max_wrong = std::max(max_wrong, std::abs(shown - truth(now_us)));
    }
    EXPECT_TRUE(settled);
    EXPECT_NEAR(max_wrong, 0, 1e-9) << "and then it is right";
  }
}

TEST(Playout, CorrectionStartsFromTheShownPose) {
  Playout playout = player(PlayoutMode::kEstimate);
  for (int i = 0; i < 10; ++i) {
    playout.add({kPlayoutZero + i * kPlayoutInterval, {static_cast<double>(i)}}, i * kPlayoutInterval);
    playout.at(i * kPlayoutInterval);
  }
  const TimeUs now_us = 10 * kPlayoutInterval - 1;
  const double before = playout.at(now_us)->coefficients[0];
  EXPECT_NEAR(before, 9.84, 0.01);
  playout.add({kPlayoutZero + 10 * kPlayoutInterval, {5}}, now_us);
  const auto after = playout.at(now_us);
  EXPECT_NEAR(after->coefficients[0], before, 1e-9);
  EXPECT_TRUE(after->settling);
  const auto later = playout.at(now_us + Correction::kBlendUs);
  EXPECT_LT(later->coefficients[0], 5) << "nothing of the error is left, only the new direction";
  EXPECT_FALSE(later->settling);
}

TEST(Playout, LateKeyReplacesEstimatesWithoutGoingBack) {
  // As a broker's rate=estimated sends: keys, then estimates beyond them; the second key is late.
  Playout playout = player(PlayoutMode::kLatest);
  const auto key = [](int i, double value) { return PlayoutPose{kPlayoutZero + i * kPlayoutInterval, {value}}; };
  const auto guess = [](TimeUs after_us, double value) {
    return PlayoutPose{kPlayoutZero + after_us, {value}, 0xff, Shown::kEstimated};
  };
  playout.add(key(0, 0), 0);
  playout.add(key(1, 1), kPlayoutInterval);
  EXPECT_EQ(playout.at(kPlayoutInterval)->shown, Shown::kLive);
  playout.add(guess(kPlayoutInterval * 3 / 2, 1.5), kPlayoutInterval * 3 / 2);
  playout.add(guess(kPlayoutInterval * 2, 2), kPlayoutInterval * 2);
  playout.add(guess(kPlayoutInterval * 5 / 2, 2.5), kPlayoutInterval * 5 / 2);
  const auto guessed = playout.at(kPlayoutInterval * 5 / 2);
  EXPECT_EQ(guessed->shown, Shown::kEstimated);
  EXPECT_EQ(guessed->coefficients[0], 2.5);
  EXPECT_TRUE(playout.add(key(2, 1.2), kPlayoutInterval * 5 / 2 + 1)) << "its time is before that of two estimates";
  const auto corrected = playout.at(kPlayoutInterval * 5 / 2 + 1);
  EXPECT_GE(corrected->time_us, guessed->time_us);
  EXPECT_NEAR(corrected->coefficients[0], 2.5, 1e-9) << "no snap";
  for (const int i : {3, 4, 9}) {
    playout.at(kPlayoutInterval * i - 1);
    playout.add(key(i, 0.8 + 0.2 * i), kPlayoutInterval * i);
  }
  const auto late = playout.at(kPlayoutInterval * 9);
  EXPECT_NEAR(late->coefficients[0], 2.6, 1e-9);
  EXPECT_EQ(late->shown, Shown::kLive);
  EXPECT_FALSE(playout.add(guess(kPlayoutInterval * 8, 9), kPlayoutInterval * 9)) << "an estimate from the past";
}

TEST(Playout, MixesOnlyBandsOfBothPoses) {
  const std::vector<std::uint32_t> ends{1, 2};
  // Row 1 is band 1; where it is absent it reads as the rest pose: 7.
  const auto full = [](int i, double high) {
    return PlayoutPose{kPlayoutZero + i * kPlayoutInterval, {1.0 * i, high}, 3};
  };
  const auto low = [](int i) { return PlayoutPose{kPlayoutZero + i * kPlayoutInterval, {1.0 * i, 7}, 1}; };
  Playout playout = player(PlayoutMode::kInterpolate, kPlayoutInterval);
  playout.set_band_ends(ends);
  for (int i = 0; i < 4; ++i) playout.add(full(i, 20), i * kPlayoutInterval);
  playout.at(3 * kPlayoutInterval);
  playout.add(low(4), 4 * kPlayoutInterval);
  const auto leaving = playout.at(4 * kPlayoutInterval + kPlayoutInterval / 2);
  EXPECT_DOUBLE_EQ(leaving->coefficients[0], 3.5);
  EXPECT_EQ(leaving->coefficients[1], 7) << "neither 20 nor between";
  EXPECT_EQ(leaving->bands, 1);
  playout.add(full(5, 30), 5 * kPlayoutInterval);
  const auto coming = playout.at(5 * kPlayoutInterval + kPlayoutInterval / 2);
  EXPECT_DOUBLE_EQ(coming->coefficients[0], 4.5);
  EXPECT_EQ(coming->coefficients[1], 7);
  EXPECT_EQ(coming->bands, 1);
  playout.add(full(6, 40), 6 * kPlayoutInterval);
  const auto back = playout.at(6 * kPlayoutInterval + kPlayoutInterval / 2);
  EXPECT_DOUBLE_EQ(back->coefficients[1], 35) << "straight: the neighbours lack the band";
  EXPECT_EQ(back->bands, 3);
  EXPECT_FALSE(back->settling) << "bands that come and go are not errors";
}

TEST(Playout, EstimatesHoldBandsOfTheNewestAlone) {
  Playout playout = player(PlayoutMode::kEstimate);
  playout.set_band_ends(std::vector<std::uint32_t>{1, 2});
  playout.add({kPlayoutZero, {0, 7}, 1}, 0);
  playout.add({kPlayoutZero + kPlayoutInterval, {1, 20}, 3}, kPlayoutInterval);
  playout.at(kPlayoutInterval);
  const auto pose = playout.at(2 * kPlayoutInterval);
  EXPECT_NEAR(pose->coefficients[0], 1 + Playout::kDamping, 1e-12);
  EXPECT_EQ(pose->coefficients[1], 20);
  EXPECT_EQ(pose->bands, 3);
}

TEST(Playout, SmoothnessScalesTheDelay) {
  TimeUs shown_us[3] = {};
  const double wanted[3] = {0, 0.5, 1};
  for (int s = 0; s < 3; ++s) {
    PlayoutSettings settings;
    settings.mode = PlayoutMode::kEstimate;
    settings.smoothness = wanted[s];
    Playout playout(settings);
    for (int i = 0; i < 100; ++i) {
      playout.add(pose_at(kPlayoutZero + i * kPlayoutInterval), i * kPlayoutInterval);
      shown_us[s] = playout.at(i * kPlayoutInterval)->time_us;
    }
    EXPECT_EQ(playout.delay_us(), static_cast<TimeUs>(wanted[s] * kPlayoutInterval));
    const Shown beyond = playout.at(99 * kPlayoutInterval + kPlayoutInterval / 4)->shown;
    EXPECT_EQ(beyond, s == 0 ? Shown::kEstimated : Shown::kInterpolated);
  }
  EXPECT_EQ(shown_us[0], kPlayoutZero + 99 * kPlayoutInterval);
  EXPECT_EQ(shown_us[1], kPlayoutZero + 99 * kPlayoutInterval - kPlayoutInterval / 2);
  EXPECT_EQ(shown_us[2], kPlayoutZero + 98 * kPlayoutInterval);
}

TEST(Playout, ModeChangeDoesNotJump) {
  Playout playout = player(PlayoutMode::kLatest);
  double shown = 0;
  TimeUs now_us = 0;
  for (int i = 0; i < 400; ++i) {
    playout.add(pose_at(kPlayoutZero + i * kPlayoutInterval), i * kPlayoutInterval);
    if (i % 100 == 99) {
      PlayoutSettings settings;
      settings.mode = i == 99 ? PlayoutMode::kInterpolate : i == 199 ? PlayoutMode::kEstimate : PlayoutMode::kLatest;
      playout.set(settings);
    }
    const bool steps = playout.settings().mode == PlayoutMode::kLatest;
    for (; now_us < (i + 1) * kPlayoutInterval; now_us += 10 * kMs) {
      const double value = playout.at(now_us)->coefficients[0];
      const double allowed = steps ? 0.041 + 0.010 : 0.0105 + 0.010 / 0.150 * 0.050;
      if (now_us > 100 * kMs) {
        EXPECT_LE(std::abs(value - shown), allowed) << now_us;
      }
      shown = value;
    }
  }
}

TEST(Playout, LatestReportsOriginAndHold) {
  Playout playout = player(PlayoutMode::kLatest);
  PlayoutPose pose = pose_at(kPlayoutZero);
  playout.add(pose, 0);
  EXPECT_EQ(playout.at(0)->shown, Shown::kLive);
  pose = pose_at(kPlayoutZero + 10 * kMs);
  pose.shown = Shown::kInterpolated;
  playout.add(pose, 10 * kMs);
  EXPECT_EQ(playout.at(10 * kMs)->shown, Shown::kInterpolated);
  EXPECT_EQ(playout.at(10 * kMs + Playout::kHeldAfterUs + 1)->shown, Shown::kHeld);
}

TEST(Playout, RestartsWhenTheSendersClockJumps) {
  Playout playout = player(PlayoutMode::kInterpolate);
  for (int i = 0; i < 50; ++i) playout.add(pose_at(kPlayoutZero + i * kPlayoutInterval), i * kPlayoutInterval);
  const TimeUs jump_us = 3'600'000 * kMs;
  for (int i = 50; i < 60; ++i)
    playout.add(pose_at(kPlayoutZero + jump_us + i * kPlayoutInterval), i * kPlayoutInterval);
  const auto pose = playout.at(59 * kPlayoutInterval);
  EXPECT_NEAR(pose->time_us, kPlayoutZero + jump_us + 58 * kPlayoutInterval, kPlayoutInterval);
}

TEST(Playout, PauseHoldsThePose) {
  Playout playout = player(PlayoutMode::kInterpolate);
  for (int i = 0; i < 50; ++i) playout.add(pose_at(kPlayoutZero + i * kPlayoutInterval), i * kPlayoutInterval);
  const auto held = playout.at(60'000 * kMs);
  EXPECT_EQ(held->time_us, kPlayoutZero + 49 * kPlayoutInterval);
  EXPECT_EQ(held->shown, Shown::kHeld);
  const TimeUs later_us = 60'000 * kMs;
  for (int i = 0; i < 5; ++i)
    playout.add(pose_at(kPlayoutZero + later_us + i * kPlayoutInterval), later_us + i * kPlayoutInterval);
  EXPECT_NEAR(playout.at(later_us + 4 * kPlayoutInterval)->time_us, kPlayoutZero + later_us + 3 * kPlayoutInterval,
              2 * kMs);
}

TEST(Playout, ShorterPosesReplaceAll) {
  Playout playout = player(PlayoutMode::kInterpolate);
  playout.add({0, {1, 2, 3}}, 0);
  playout.add({kPlayoutInterval, {1, 2}}, kPlayoutInterval);
  EXPECT_EQ(playout.at(kPlayoutInterval)->coefficients.size(), 2U);
}

/// Of a stream that has learnt columns: those were zero.
TEST(Playout, PosesBeforeLongerOnesAreZeroThere) {
  Playout playout = player(PlayoutMode::kInterpolate, kPlayoutInterval);
  playout.add(pose_at(kPlayoutZero), 0);
  playout.add(pose_at(kPlayoutZero + kPlayoutInterval), kPlayoutInterval);
  playout.at(kPlayoutInterval);
  playout.add({kPlayoutZero + 2 * kPlayoutInterval, {0.08, 1.0}}, 2 * kPlayoutInterval);
  const auto pose = playout.at(5 * kPlayoutInterval / 2);
  ASSERT_TRUE(pose && pose->coefficients.size() == 2);
  EXPECT_EQ(pose->shown, Shown::kInterpolated);
  EXPECT_NEAR(pose->coefficients[0], 0.06, 1e-9);
  EXPECT_GT(pose->coefficients[1], 0.2);
  EXPECT_LT(pose->coefficients[1], 0.8);
}

TEST(Playout, QueueIsBoundedUnderHostileTimes) {
  Playout playout = player(PlayoutMode::kInterpolate);
  for (int i = 0; i < 1000; ++i) playout.add(pose_at(i * kMs), 0);
  // All but the newest kMaxPoses are gone: even the far past shows the oldest of these.
  EXPECT_EQ(playout.at(-1'000'000 * kMs)->time_us, (1000 - static_cast<TimeUs>(Playout::kMaxPoses)) * kMs);

  constexpr TimeUs kLow = std::numeric_limits<TimeUs>::min(), kHigh = std::numeric_limits<TimeUs>::max();
  for (const auto mode : {PlayoutMode::kInterpolate, PlayoutMode::kEstimate}) {
    Playout hostile = player(mode);
    hostile.add({kLow, {1}}, kHigh);
    hostile.add({kLow + 1, {1}}, kHigh);
    hostile.add({0, {1}}, kLow);
    hostile.add({kHigh - 1, {1}}, 0);
    hostile.add({kHigh, {1}}, kHigh);
    for (const TimeUs now_us : {kLow, TimeUs{0}, kHigh}) EXPECT_EQ(hostile.at(now_us)->coefficients.size(), 1U);
  }
}

}  // namespace
}  // namespace eigencast
