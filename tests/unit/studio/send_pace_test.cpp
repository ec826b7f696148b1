// SPDX-License-Identifier: MIT
#include "sender/studio/hand.h"

#include <gtest/gtest.h>

namespace eigencast::studio {
namespace {

TEST(SendPace, FirstPoseAfterAPauseGoesAtOnce) {
  SendPace pace(20'000, 500'000);
  EXPECT_LE(pace.due_us(1000), 1000);
  pace.sent(1000);
  pace.changed();
  EXPECT_LE(pace.due_us(300'000), 300'000);
}

TEST(SendPace, PosesInQuickSuccessionWaitForTheInterval) {
  SendPace pace(20'000, 500'000);
  pace.sent(1000);
  pace.changed();
  EXPECT_EQ(pace.due_us(2000), 21'000);
  pace.changed();
  EXPECT_EQ(pace.due_us(9000), 21'000) << "the newest goes when the first would have";
}

TEST(SendPace, IdleSendsAHeartbeat) {
  SendPace pace(20'000, 500'000);
  pace.sent(1000);
  EXPECT_EQ(pace.due_us(2000), 501'000);
}

}  // namespace
}  // namespace eigencast::studio
