// SPDX-License-Identifier: MIT
#include "common/net/backoff.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kFirst{200}, kLongest{5000};

TEST(Backoff, DoublesUpToTheLongest) {
  const int expected[] = {200, 400, 800, 1600, 3200, 5000, 5000};
  for (int failures = 1; failures <= 7; ++failures)
    EXPECT_EQ(retry_delay(failures, kFirst, kLongest, 0.5).count(), expected[failures - 1]);
}

TEST(Backoff, JitterStaysWithinAQuarter) {
  for (const int failures : {1, 3, 64, 1000000}) {
    const auto middle = retry_delay(failures, kFirst, kLongest, 0.5).count();
    EXPECT_EQ(retry_delay(failures, kFirst, kLongest, 0).count(), middle * 3 / 4);
    EXPECT_EQ(retry_delay(failures, kFirst, kLongest, 1).count(), middle * 5 / 4);
  }
}

TEST(Backoff, NeverFallsBelowTheFirst) {
  EXPECT_EQ(retry_delay(5, kFirst, milliseconds(10), 0.5), kFirst);
}

}  // namespace
}  // namespace eigencast
