// SPDX-License-Identifier: MIT
#include "common/motion/forecaster.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <random>
#include <vector>

#include "tests/unit/motion/support.h"

namespace eigencast {
namespace {

constexpr TimeUs kForecasterInterval = 60 * kMs;

struct EmittedPose {
  TimeUs media_us;  ///< Since the sender began.
  TimeUs at_us;
  std::uint64_t sequence;
  int at;  ///< 0: a key.
};

/// Keys at even times, each with its transit time; a negative one never arrives. Wakes every 100 us.
std::vector<EmittedPose> run_forecaster(Forecaster& forecaster, int keys, const std::function<TimeUs(int)>& way_of,
                                        TimeUs rest_us = 0) {
  std::vector<EmittedPose> emitted;
  TimeUs now_us = 0, last_us = 0;
  const auto pump_until = [&](TimeUs end_us) {
    for (; now_us < end_us; now_us += 100) {
      while (const auto due = forecaster.pop_due(now_us))
        emitted.push_back({due->capture_us - kSenderZero, now_us, due->sequence, due->at});
    }
  };
  for (int i = 0; i < keys; ++i) {
    if (way_of(i) < 0) continue;
    last_us = std::max(last_us, i * kForecasterInterval + way_of(i));
    pump_until(last_us);
    forecaster.add_key(static_cast<std::uint64_t>(i + 1), kSenderZero + i * kForecasterInterval, last_us);
    emitted.push_back({i * kForecasterInterval, last_us, static_cast<std::uint64_t>(i + 1), 0});
  }
  pump_until(now_us + rest_us);
  return emitted;
}

std::vector<EmittedPose> estimates(const std::vector<EmittedPose>& all) {
  std::vector<EmittedPose> only;
  for (const EmittedPose& pose : all) {
    if (pose.at > 0) only.push_back(pose);
  }
  return only;
}

TEST(Forecaster, EvenKeysGiveEvenEstimates) {
  Forecaster forecaster(3);
  const auto emitted = run_forecaster(forecaster, 20, [](int) { return 10 * kMs; });
  // From the second key on: two estimates after each; the next key replaces the third.
  int between = 0;
  for (const EmittedPose& pose : estimates(emitted)) {
    EXPECT_EQ(pose.media_us,
              static_cast<TimeUs>(pose.sequence - 1) * kForecasterInterval + pose.at * kForecasterInterval / 3);
    EXPECT_NEAR(pose.at_us, pose.media_us + 10 * kMs, 100);
    EXPECT_LE(pose.at, 3);
    ++between;
  }
  EXPECT_GE(between, 2 * 18);
  EXPECT_LE(between, 3 * 18);
}

TEST(Forecaster, MediaTimeNeverRunsBackwards) {
  std::mt19937 random(7);
  std::uniform_int_distribution<TimeUs> jitter(0, 45 * kMs);
  std::vector<TimeUs> ways;
  for (int i = 0; i < 300; ++i) ways.push_back(10 * kMs + jitter(random));
  Forecaster forecaster(3);
  const auto only =
      estimates(run_forecaster(forecaster, 300, [&](int i) { return ways[static_cast<std::size_t>(i)]; }));
  int uneven = 0;
  for (std::size_t i = 1; i < only.size(); ++i) {
    EXPECT_GT(only[i].media_us, only[i - 1].media_us);
    const TimeUs step_us = only[i].media_us - only[i - 1].media_us;
    // The bound: at most half a key interval above the minimal transit time.
    EXPECT_LE(only[i].at_us - only[i].media_us, 10 * kMs + 45 * kMs + kForecasterInterval / 2);
    // Where no key came between, poses are a third of an interval apart, in media time and in time.
    if (step_us == kForecasterInterval / 3 && std::abs(only[i].at_us - only[i - 1].at_us - step_us) > 2 * kMs) ++uneven;
  }
  EXPECT_LT(uneven, static_cast<int>(only.size()) / 20);
}

TEST(Forecaster, KeysASecondLateDoNotRunBackwards) {
  Forecaster forecaster(3);
  TimeUs newest_us = 0;
  for (const EmittedPose& pose : estimates(run_forecaster(
           forecaster, 20, [](int i) { return i < 10 ? 10 * kMs : 1'300 * kMs; }, 200 * kMs))) {
    EXPECT_GT(pose.media_us, newest_us) << "estimate " << pose.at << " of key " << pose.sequence;
    newest_us = pose.media_us;
  }
  EXPECT_GT(newest_us, 19 * kForecasterInterval);
}

TEST(Forecaster, EstimatesReplaceAMissingKeyThenEnd) {
  Forecaster forecaster(3, 200 * kMs);
  const auto emitted = estimates(run_forecaster(
      forecaster, 10, [](int) { return 5 * kMs; }, 1000 * kMs));
  ASSERT_FALSE(emitted.empty());
  EXPECT_EQ(emitted.back().sequence, 10U);
  EXPECT_EQ(emitted.back().at, 10) << "200 ms are ten thirds of an interval";
  EXPECT_FALSE(forecaster.next_due_us());
}

TEST(Forecaster, EstimatesPerKeyAreLimited) {
  Forecaster forecaster(15, 10'000 * kMs);
  const auto emitted = estimates(run_forecaster(
      forecaster, 2, [](int) { return 5 * kMs; }, 5000 * kMs));
  EXPECT_EQ(emitted.size(), 15U);
}

TEST(Forecaster, OneKeyOrAGapHasNoDirection) {
  Forecaster forecaster(3);
  forecaster.add_key(1, kSenderZero, 0);
  EXPECT_FALSE(forecaster.next_due_us());
  forecaster.add_key(3, kSenderZero + kForecasterInterval, kForecasterInterval);
  EXPECT_FALSE(forecaster.next_due_us()) << "key 2 is missing";
  forecaster.add_key(4, kSenderZero + 2 * kForecasterInterval, 2 * kForecasterInterval);
  EXPECT_TRUE(forecaster.next_due_us());
  forecaster.add_key(5, kSenderZero + 100 * kForecasterInterval, 100 * kForecasterInterval);
  EXPECT_FALSE(forecaster.next_due_us()) << "a pause";
}

TEST(Forecaster, BurstLeavesEstimatesOfTheNewestKey) {
  Forecaster forecaster(3);
  const auto emitted =
      run_forecaster(forecaster, 20, [](int i) { return i < 10 ? 5 * kMs : (20 - i) * kForecasterInterval; });
  for (const EmittedPose& pose : estimates(emitted)) EXPECT_LE(pose.sequence, 10U);
}

TEST(Forecaster, ClockStepsRestart) {
  for (const TimeUs step_us : {-3'600'000 * kMs, 3'600'000 * kMs}) {
    Forecaster forecaster(3);
    for (int i = 0; i < 10; ++i)
      forecaster.add_key(static_cast<std::uint64_t>(i), kSenderZero + i * kForecasterInterval, i * kForecasterInterval);
    for (int i = 10; i < 13; ++i)
      forecaster.add_key(static_cast<std::uint64_t>(i), kSenderZero + step_us + i * kForecasterInterval,
                         i * kForecasterInterval);
    const auto next = forecaster.next_due_us();
    ASSERT_TRUE(next);
    EXPECT_NEAR(*next, 12 * kForecasterInterval + kForecasterInterval / 3, kMs);
  }
}

TEST(Forecaster, SurvivesHostileTimes) {
  constexpr TimeUs kLow = std::numeric_limits<TimeUs>::min(), kHigh = std::numeric_limits<TimeUs>::max();
  Forecaster forecaster(15);
  std::uint64_t sequence = 0;
  for (const TimeUs capture_us : {kLow, TimeUs{0}, kHigh, kHigh, kLow}) {
    for (const TimeUs arrival_us : {kHigh, kLow, TimeUs{0}}) {
      forecaster.add_key(++sequence, capture_us, arrival_us);
      while (forecaster.pop_due(kHigh)) {
      }
    }
  }
}

}  // namespace
}  // namespace eigencast
