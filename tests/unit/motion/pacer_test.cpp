// SPDX-License-Identifier: MIT
#include "common/motion/pacer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <random>
#include <set>
#include <vector>

#include "tests/unit/motion/support.h"

namespace eigencast {
namespace {

constexpr TimeUs kPacerInterval = 100 * kMs;

struct Key {
  std::uint64_t sequence;
  TimeUs capture_us;
  TimeUs arrival_us;
};

struct Emitted {
  Pacer::Due due;
  TimeUs at_us;
};

// Keys at even capture times, each `delay_of(i)` under way; the link keeps their order.
std::vector<Key> keys_with(int count, const std::function<TimeUs(int)>& delay_of, double drift = 0) {
  std::vector<Key> keys;
  TimeUs last_us = 0;
  for (int i = 0; i < count; ++i) {
    const TimeUs made_us = i * kPacerInterval;
    last_us = std::max(last_us, made_us + delay_of(i));
    const auto on_senders_clock = static_cast<TimeUs>(static_cast<double>(made_us) * (1 + drift));
    keys.push_back({static_cast<std::uint64_t>(i + 1), kSenderZero + on_senders_clock, last_us});
  }
  return keys;
}

// A broker that wakes exactly when something is due or a key comes.
std::vector<Emitted> run_pacer(Pacer& pacer, const std::vector<Key>& keys) {
  std::vector<Emitted> emitted;
  const auto pop_until = [&](TimeUs now_us) {
    for (auto next = pacer.next_due_us(); next && *next <= now_us; next = pacer.next_due_us()) {
      const TimeUs wake_us = std::max(*next, emitted.empty() ? *next : emitted.back().at_us);
      const auto due = pacer.pop_due(wake_us);
      ASSERT_TRUE(due);
      emitted.push_back({*due, wake_us});
    }
  };
  for (const Key& key : keys) {
    pop_until(key.arrival_us - 1);
    pacer.add_key(key.sequence, key.capture_us, key.arrival_us);
    // Overdue poses are emitted now, not in the past.
    while (const auto due = pacer.pop_due(key.arrival_us)) emitted.push_back({*due, key.arrival_us});
  }
  pop_until(std::numeric_limits<TimeUs>::max());
  return emitted;
}

void expect_ordered(const std::vector<Emitted>& emitted) {
  for (std::size_t i = 1; i < emitted.size(); ++i) {
    EXPECT_LT(emitted[i - 1].due.capture_us, emitted[i].due.capture_us) << i;
    EXPECT_LE(emitted[i - 1].at_us, emitted[i].at_us) << i;
    EXPECT_LE(emitted[i - 1].due.due_us, emitted[i].due.due_us) << i;
  }
}

// Gaps between emitted poses after the first second, in which the delay is learnt.
std::vector<TimeUs> gaps_after(const std::vector<Emitted>& emitted, TimeUs from_us) {
  std::vector<TimeUs> gaps;
  for (std::size_t i = 1; i < emitted.size(); ++i) {
    if (emitted[i - 1].at_us >= from_us) gaps.push_back(emitted[i].at_us - emitted[i - 1].at_us);
  }
  return gaps;
}

TEST(Pacer, EvenKeysGiveKPosesEachExactlyEvenly) {
  for (const int k : {1, 2, 3, 5, 15}) {
    Pacer pacer(static_cast<std::uint8_t>(k));
    const auto emitted = run_pacer(pacer, keys_with(50, [](int) { return 20 * kMs; }));
    ASSERT_EQ(emitted.size(), 1U + 49U * static_cast<unsigned>(k));
    expect_ordered(emitted);
    for (const TimeUs gap : gaps_after(emitted, 100 * kMs)) EXPECT_NEAR(gap, kPacerInterval / k, 1);
    // No needless wait: the first pose of an interval is emitted when its key arrives.
    const Emitted& first = emitted[1];
    EXPECT_EQ(first.due.at, 1);
    EXPECT_EQ(first.at_us, 120 * kMs);
    EXPECT_EQ(pacer.dropped(), 0U);
  }
}

TEST(Pacer, CaptureTimesAreThoseOfEq7) {
  Pacer pacer(3);
  pacer.add_key(7, 1000, 0);
  pacer.add_key(8, 91000, 90000);
  std::vector<Pacer::Due> due;
  while (const auto next = pacer.pop_due(10'000'000)) due.push_back(*next);
  ASSERT_EQ(due.size(), 4U);
  EXPECT_EQ(due[0].sequence, 7U);
  EXPECT_EQ(due[0].at, due[0].of);
  for (std::uint8_t at = 1; at <= 3; ++at) {
    EXPECT_EQ(due[at].sequence, 8U);
    EXPECT_EQ(due[at].at, at);
    EXPECT_EQ(due[at].of, 3);
    EXPECT_EQ(due[at].capture_us, 1000 + 30000 * at);
  }
}

TEST(Pacer, NothingIsDueBeforeItsTime) {
  Pacer pacer(3);
  EXPECT_FALSE(pacer.next_due_us());
  EXPECT_FALSE(pacer.pop_due(std::numeric_limits<TimeUs>::max()));
  pacer.add_key(1, 0, 500);
  ASSERT_EQ(pacer.next_due_us(), 500);
  EXPECT_FALSE(pacer.pop_due(499));
  EXPECT_TRUE(pacer.pop_due(500));
  EXPECT_FALSE(pacer.pop_due(500));
}

TEST(Pacer, JitterIsSmoothedOut) {
  std::mt19937 random(1);
  std::uniform_int_distribution<TimeUs> jitter(0, 60 * kMs);
  Pacer pacer(3);
  const auto keys = keys_with(600, [&](int) { return 10 * kMs + jitter(random); });
  const auto emitted = run_pacer(pacer, keys);
  EXPECT_EQ(emitted.size(), 1U + 599U * 3);
  EXPECT_EQ(pacer.dropped(), 0U);
  expect_ordered(emitted);
  // Keys arrive 40 to 160 ms apart; poses are emitted 33 ms apart, plus or minus the delay's adaptation.
  auto gaps = gaps_after(emitted, 3'000 * kMs);
  std::sort(gaps.begin(), gaps.end());
  EXPECT_GT(gaps[gaps.size() / 50], 31 * kMs);
  EXPECT_LT(gaps[gaps.size() * 49 / 50], 35 * kMs);
  EXPECT_LT(gaps.back(), 45 * kMs);
  // The price: no more than the jitter and two thirds of an interval.
  for (const Emitted& e : emitted) {
    EXPECT_LE(e.at_us - (e.due.capture_us - kSenderZero), 70 * kMs + kPacerInterval * 2 / 3);
  }
}

TEST(Pacer, DelayShrinksAgainWhenTheLinkCalmsDown) {
  Pacer pacer(3);
  const auto emitted =
      run_pacer(pacer, keys_with(200, [](int i) { return i % 7 == 3 && i < 60 ? 80 * kMs : 10 * kMs; }));
  expect_ordered(emitted);
  const auto& last = emitted.back();
  EXPECT_NEAR(last.at_us - (last.due.capture_us - kSenderZero), 10 * kMs + kPacerInterval * 2 / 3, 2);
  for (const TimeUs gap : gaps_after(emitted, 6'000 * kMs))
    EXPECT_NEAR(gap, kPacerInterval / 3, kPacerInterval / 3 / 25);
}

TEST(Pacer, FollowsClocksThatDrift) {
  for (const double drift : {-2e-4, 2e-4}) {
    Pacer pacer(3);
    const auto emitted = run_pacer(pacer, keys_with(
                                              6000, [](int) { return 10 * kMs; }, drift));
    EXPECT_EQ(emitted.size(), 1U + 5999U * 3);
    expect_ordered(emitted);
    // Ten minutes: the clocks are 120 ms apart in the end, the delay in true time is still that of the beginning.
    for (const Emitted& e : emitted) {
      const double made_us = static_cast<double>(e.due.capture_us - kSenderZero) / (1 + drift);
      EXPECT_LT(static_cast<double>(e.at_us) - made_us, 10 * kMs + kPacerInterval * 2.0 / 3 + 1 * kMs);
    }
    for (const TimeUs gap : gaps_after(emitted, 200 * kMs)) EXPECT_NEAR(gap, kPacerInterval / 3, 200);
  }
}

TEST(Pacer, StalledLinkDropsExpiredPosesAndStaysEven) {
  Pacer pacer(3);
  // Keys 50 to 54 are held for up to half a second and come together.
  const auto keys =
      keys_with(100, [](int i) { return i >= 50 && i < 55 ? (55 - i) * kPacerInterval + 10 * kMs : 10 * kMs; });
  const auto emitted = run_pacer(pacer, keys);
  expect_ordered(emitted);
  EXPECT_GT(pacer.dropped(), 0U);
  std::set<std::uint64_t> sequences;
  for (const Emitted& e : emitted) sequences.insert(e.due.sequence);
  EXPECT_GE(sequences.size(), 96U);
  // Within a second it is even again, with the delay that it had.
  const TimeUs calm_us = 6'600 * kMs;
  for (const TimeUs gap : gaps_after(emitted, calm_us)) EXPECT_NEAR(gap, kPacerInterval / 3, kPacerInterval / 3 / 25);
  EXPECT_LE(emitted.back().at_us - (emitted.back().due.capture_us - kSenderZero), 10 * kMs + kPacerInterval * 5 / 3);
}

TEST(Pacer, BurstQueuesAtMostTwoIntervals) {
  for (const std::uint8_t k : {1, 3, 15}) {
    Pacer pacer(k);
    for (int i = 0; i < 10; ++i) pacer.add_key(static_cast<std::uint64_t>(i), i * kPacerInterval, i * kPacerInterval);
    for (int i = 10; i < 1000; ++i) {
      pacer.add_key(static_cast<std::uint64_t>(i), i * kPacerInterval, 10 * kPacerInterval);
      Pacer copy = pacer;
      std::set<std::uint64_t> waiting;
      while (const auto due = copy.pop_due(std::numeric_limits<TimeUs>::max())) waiting.insert(due->sequence);
      ASSERT_LE(waiting.size(), 2U);
      ASSERT_TRUE(waiting.contains(static_cast<std::uint64_t>(i))) << "the newest is never dropped";
    }
  }
}

TEST(Pacer, LongerDelayIsAdoptedAfterThreeKeys) {
  Pacer pacer(3);
  const auto emitted = run_pacer(pacer, keys_with(100, [](int i) { return i < 50 ? 10 * kMs : 400 * kMs; }));
  expect_ordered(emitted);
  std::size_t late = 0;
  for (const Emitted& e : emitted) late += e.due.sequence > 55 ? 1 : 0;
  EXPECT_EQ(late, 45U * 3) << "all poses are made again after five keys";
}

TEST(Pacer, PauseIsNotBridged) {
  Pacer pacer(3);
  std::vector<Key> keys = keys_with(20, [](int) { return 10 * kMs; });
  for (int i = 0; i < 20; ++i) {
    Key key = keys[static_cast<std::size_t>(i)];
    key.sequence += 20;
    key.capture_us += 60'000 * kMs;
    key.arrival_us += 60'000 * kMs;
    keys.push_back(key);
  }
  const auto emitted = run_pacer(pacer, keys);
  expect_ordered(emitted);
  ASSERT_EQ(emitted.size(), 2 * (1U + 19U * 3));
  const Emitted& first = emitted[1 + 19 * 3];
  EXPECT_EQ(first.due.sequence, 21U);
  EXPECT_EQ(first.due.at, first.due.of);
  EXPECT_NEAR(emitted[2 + 19 * 3].at_us - first.at_us, kPacerInterval / 3, 1) << "in step with what follows";
}

TEST(Pacer, ForwardClockStepKeepsPosesFlowing) {
  for (const TimeUs jump_us : {600 * kMs, 3'600'000 * kMs}) {
    Pacer pacer(3);
    std::vector<Key> keys = keys_with(40, [](int) { return 10 * kMs; });
    for (std::size_t i = 20; i < keys.size(); ++i) keys[i].capture_us += jump_us;
    const auto emitted = run_pacer(pacer, keys);
    expect_ordered(emitted);
    std::size_t after = 0;
    for (const Emitted& e : emitted) {
      if (e.due.sequence < 21) continue;
      ++after;
      const TimeUs arrival_us = keys[e.due.sequence - 1].arrival_us;
      EXPECT_GE(e.at_us, arrival_us);
      EXPECT_LE(e.at_us, arrival_us + kPacerInterval) << e.due.sequence << ' ' << int{e.due.at};
    }
    EXPECT_EQ(after, 1U + 19U * 3);
  }
}

TEST(Pacer, SequenceGapIsNotBridged) {
  Pacer pacer(3);
  std::vector<Key> keys = keys_with(20, [](int) { return 10 * kMs; });
  keys.erase(keys.begin() + 10);
  for (const Emitted& e : run_pacer(pacer, keys)) {
    EXPECT_NE(e.due.sequence, 11U);
    if (e.due.sequence == 12) {
      EXPECT_EQ(e.due.at, e.due.of) << "key 11 is not there to start from";
    }
  }
}

TEST(Pacer, BackwardKeysRestart) {
  Pacer pacer(3);
  for (int i = 0; i < 10; ++i)
    pacer.add_key(static_cast<std::uint64_t>(100 + i), i * kPacerInterval, i * kPacerInterval);
  pacer.add_key(5, 3 * kPacerInterval, 20 * kPacerInterval);
  EXPECT_EQ(pacer.next_due_us(), 20 * kPacerInterval);
  const auto due = pacer.pop_due(20 * kPacerInterval);
  ASSERT_TRUE(due);
  EXPECT_EQ(due->sequence, 5U);
  EXPECT_EQ(due->at, due->of);
  EXPECT_FALSE(pacer.next_due_us());
  pacer.add_key(6, 3 * kPacerInterval, 21 * kPacerInterval);  // A growing number, but the same capture time.
  EXPECT_EQ(pacer.pop_due(21 * kPacerInterval)->sequence, 6U);
  pacer.add_key(7, 4 * kPacerInterval, 22 * kPacerInterval);
  EXPECT_EQ(pacer.pop_due(22 * kPacerInterval)->at, 1);
  pacer.reset();
  EXPECT_FALSE(pacer.next_due_us());
}

TEST(Pacer, HostileTimesAreSafe) {
  constexpr TimeUs kLow = std::numeric_limits<TimeUs>::min(), kHigh = std::numeric_limits<TimeUs>::max();
  std::mt19937_64 random(3);
  const TimeUs values[] = {kLow, kLow + 1, -1, 0, 1, 1000, kHigh - 1, kHigh};
  Pacer pacer(15, kHigh);
  for (std::uint64_t i = 0; i < 20'000; ++i) {
    pacer.add_key(i, values[random() % 8], values[random() % 8]);
    std::size_t count = 0;
    while (pacer.pop_due(kHigh)) ++count;
    ASSERT_LE(count, 30U);
  }
}

}  // namespace
}  // namespace eigencast
