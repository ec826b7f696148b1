// SPDX-License-Identifier: MIT
#include "broker/relay/reader_watch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace eigencast::broker {
namespace {

constexpr TimeUs kRoundTripUs = 20'000;

TEST(ReaderWatch, ChecksEvery32ndFrame) {
  ReaderWatch watch;
  int checks = 0;
  for (int i = 0; i < 320; ++i) checks += watch.note_sent() ? 1 : 0;
  EXPECT_EQ(checks, 10);
}

TEST(ReaderWatch, ChecksAreSpreadOverConnections) {
  std::vector<ReaderWatch> watches;
  for (std::uint64_t id = 1000; id < 1064; ++id) watches.emplace_back(id);
  for (int frame = 0; frame < 64; ++frame) {
    EXPECT_EQ(std::count_if(watches.begin(), watches.end(), [](ReaderWatch& watch) { return watch.note_sent(); }), 2);
  }
}

TEST(ReaderWatch, WideWindowIsNotProbed) {
  ReaderWatch watch;
  for (const std::uint32_t bytes : {64'000u, 65'000u, 63'000u, 6'000'000u, 5'998'000u}) {
    EXPECT_FALSE(watch.note_window(bytes, kRoundTripUs, 1'000));
    EXPECT_FALSE(watch.is_probing());
    EXPECT_EQ(watch.hold_from_us(), ReaderWatch::kNever);
  }
}

TEST(ReaderWatch, HoldsUntilWindowIsWideAgain) {
  ReaderWatch watch;
  EXPECT_FALSE(watch.note_window(65'000, kRoundTripUs, 0));
  EXPECT_TRUE(watch.note_window(40'000, kRoundTripUs, 1'000'000));
  EXPECT_EQ(watch.hold_from_us(), 1'000'000 + kRoundTripUs + 20'000);
  EXPECT_TRUE(watch.note_window(39'000, kRoundTripUs, 2'000'000)) << "asked again, by the same probe";
  EXPECT_EQ(watch.probe(), "1");
  EXPECT_EQ(watch.hold_from_us(), 1'000'000 + kRoundTripUs + 20'000) << "it has been overdue for as long";
  EXPECT_FALSE(watch.note_window(64'000, kRoundTripUs, 3'000'000));
  EXPECT_EQ(watch.hold_from_us(), ReaderWatch::kNever);
}

/// What the window of a peer that reads everything is after frames of many sizes: the last ones are not read yet.
TEST(ReaderWatch, WindowsThatFollowTheSizesOfFramesHoldShortlyAndOnce) {
  ReaderWatch watch;
  TimeUs now_us = 0, held_us = 0;
  for (int i = 0; i < 1'000; ++i, now_us += 10'000) {
    const bool is_held = now_us >= watch.hold_from_us();
    held_us += is_held ? 10'000 : 0;
    // What an acknowledgement of a ping shows where no frame follows it.
    const std::uint32_t unread = is_held ? 0 : static_cast<std::uint32_t>(i * 7919 % 20'000);
    if (watch.is_probing() ? watch.is_check_due(now_us) : i % 32 == 0)
      watch.note_window(65'000 - unread, kRoundTripUs, now_us);
  }
  EXPECT_LT(held_us, 1'000'000);
  EXPECT_FALSE(watch.is_probing());
  for (int i = 0; i < 10; ++i) watch.note_window(30'000, kRoundTripUs, now_us);
  EXPECT_TRUE(watch.is_probing()) << "nothing of what came is read";
  EXPECT_TRUE(watch.note_window(30'000, kRoundTripUs, watch.hold_from_us())) << "asked when frames wait";
  EXPECT_FALSE(watch.note_window(30'000, kRoundTripUs, watch.hold_from_us() + 500'000)) << "and once a second";
}

TEST(ReaderWatch, AWindowThatStaysNarrowCountsAsWideInTimeLaterEachTime) {
  ReaderWatch watch;
  std::uint32_t bytes = 65'000;
  int holds = 0;
  for (TimeUs now_us = 0; now_us < 60'000'000; now_us += 10'000) {
    const bool is_held = now_us >= watch.hold_from_us(), was_probing = watch.is_probing();
    if (!is_held) bytes -= std::min(bytes, 20u);  // It reads nothing.
    if (is_held ? watch.is_check_due(now_us) : now_us % 320'000 == 0) watch.note_window(bytes, kRoundTripUs, now_us);
    holds += watch.is_probing() && !was_probing ? 1 : 0;
  }
  EXPECT_GE(holds, 3);
  EXPECT_LE(holds, 5);
  EXPECT_GT(bytes, 10'000) << "one that stands still gets little for a minute";
}

TEST(ReaderWatch, AWindowThatWidensIsRead) {
  ReaderWatch watch;
  watch.note_window(65'000, kRoundTripUs, 0);
  EXPECT_TRUE(watch.note_window(30'000, kRoundTripUs, 1'000'000));
  EXPECT_TRUE(watch.note_window(29'000, kRoundTripUs, 2'000'000));
  EXPECT_FALSE(watch.note_window(50'000, kRoundTripUs, 3'000'000));
  EXPECT_FALSE(watch.is_probing()) << "its kernel offers less than before";
  EXPECT_FALSE(watch.note_window(49'000, kRoundTripUs, 4'000'000));
}

TEST(ReaderWatch, MatchingPongEndsHold) {
  ReaderWatch watch;
  watch.note_window(65'000, kRoundTripUs, 0);
  watch.note_window(40'000, kRoundTripUs, 1'000'000);
  EXPECT_FALSE(watch.note_pong("")) << "not our ping";
  EXPECT_FALSE(watch.note_pong("0"));
  EXPECT_TRUE(watch.is_probing());
  EXPECT_TRUE(watch.note_pong("1"));
  EXPECT_FALSE(watch.is_probing());
  EXPECT_FALSE(watch.note_pong("1")) << "answered already";
  EXPECT_FALSE(watch.note_window(40'000, kRoundTripUs, 3'000'000)) << "it reads, and offers no more than this";
  EXPECT_TRUE(watch.note_window(35'000, kRoundTripUs, 4'000'000));
  EXPECT_FALSE(watch.note_pong("1")) << "of before";
  EXPECT_TRUE(watch.note_pong("2"));
}

}  // namespace
}  // namespace eigencast::broker
