// SPDX-License-Identifier: MIT
#include "common/core/histogram.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

TEST(Histogram, IsEmptyAtFirst) {
  const Histogram h;
  EXPECT_EQ(h.count(), 0u);
  EXPECT_EQ(h.percentile(50), 0);
}

TEST(Histogram, SmallValuesAreExact) {
  Histogram h;
  for (int v = 1; v <= 50; ++v) h.add(v);
  EXPECT_EQ(h.percentile(50), 25);
  EXPECT_EQ(h.percentile(100), 50);
  EXPECT_EQ(h.percentile(0), 1);
}

TEST(Histogram, PercentilesAreAtMostOne32ndTooHigh) {
  for (std::int64_t v = 1; v < (std::int64_t{1} << 39); v = v * 17 / 13 + 1) {
    Histogram h;
    h.add(v);
    h.add(std::int64_t{1} << 39);
    EXPECT_GE(h.percentile(50), v);
    EXPECT_LE(static_cast<double>(h.percentile(50)), static_cast<double>(v) * (1 + 1.0 / 32));
  }
}

TEST(Histogram, NegativeValuesAreCountedApart) {
  Histogram h;
  h.add(-5);
  h.add(5);
  EXPECT_EQ(h.negative(), 1u);
  EXPECT_EQ(h.count(), 1u);
  EXPECT_EQ(h.percentile(0), 5);
}

TEST(Histogram, HugeValuesKeepTheirMaximum) {
  Histogram h;
  h.add(std::int64_t{1} << 60);
  EXPECT_EQ(h.percentile(99), std::int64_t{1} << 60);
}

TEST(Histogram, MergingEqualsAddingAll) {
  Histogram a, b, all;
  for (int v = 0; v < 1000; ++v) {
    (v % 3 ? a : b).add(v * 7);
    all.add(v * 7);
  }
  a.merge(b);
  EXPECT_EQ(a.count(), all.count());
  for (const double p : {1.0, 50.0, 99.0, 99.9}) EXPECT_EQ(a.percentile(p), all.percentile(p));
}

TEST(Histogram, MomentsAreThoseOfTheValues) {
  Histogram h;
  for (const int v : {2, 4, 4, 4, 5, 5, 7, 9}) h.add(v);
  EXPECT_DOUBLE_EQ(h.mean(), 5);
  EXPECT_DOUBLE_EQ(h.standard_deviation(), 2);
  EXPECT_EQ(h.min(), 2);
}

}  // namespace
}  // namespace eigencast
