// SPDX-License-Identifier: MIT
#include "tools/latency/hdr_histogram.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace eigencast::latency {
namespace {

TEST(HdrHistogram, PercentilesMatchSortedValues) {
  std::mt19937_64 random(1);
  std::lognormal_distribution<double> draw(7, 2);
  HdrHistogram h;
  std::vector<std::int64_t> values;
  for (int i = 0; i < 20'000; ++i) {
    values.push_back(static_cast<std::int64_t>(draw(random)));
    h.add(values.back());
  }
  std::sort(values.begin(), values.end());
  for (const double p : {0.0, 1.0, 25.0, 50.0, 90.0, 99.0, 99.9, 100.0}) {
    const auto rank = std::max<std::size_t>(1, static_cast<std::size_t>(std::ceil(p / 100 * 20'000)));
    const double truth = static_cast<double>(values[rank - 1]);
    EXPECT_GE(static_cast<double>(h.percentile(p)), truth) << p;
    EXPECT_LE(static_cast<double>(h.percentile(p)), truth * 1.001 + 1) << p;
  }
  EXPECT_EQ(h.max(), values.back());
  EXPECT_EQ(h.min(), values.front());
}

TEST(HdrHistogram, SmallValuesAreExact) {
  for (const std::int64_t value : {0, 1, 1023, 1024, 2047}) {
    HdrHistogram h;
    h.add(value);
    h.add(3000);
    EXPECT_EQ(h.percentile(50), value);
  }
}

TEST(HdrHistogram, NegativeValuesAreCountedApart) {
  HdrHistogram h;
  h.add(-5);
  h.add(-70);
  h.add(10);
  EXPECT_EQ(h.count(), 1u);
  EXPECT_EQ(h.negative(), 2u);
  EXPECT_EQ(h.min(), 10);
}

TEST(HdrHistogram, UnreliablePercentilesAreNotReturned) {
  HdrHistogram h;
  for (int i = 0; i < 100; ++i) h.add(i);
  EXPECT_TRUE(h.reliable_percentile(90));
  EXPECT_FALSE(h.reliable_percentile(91));
  EXPECT_FALSE(h.reliable_percentile(99));
  EXPECT_EQ(h.reliable_percentile(100), 99);
  EXPECT_FALSE(HdrHistogram().reliable_percentile(100));
}

TEST(HdrHistogram, MergingIsCountingBoth) {
  HdrHistogram a, b, both;
  for (int i = 0; i < 1000; ++i) {
    a.add(i);
    both.add(i);
    b.add(100'000 + i);
    both.add(100'000 + i);
  }
  b.add(-1);
  both.add(-1);
  a.merge(b);
  EXPECT_EQ(a.count(), both.count());
  EXPECT_EQ(a.negative(), 1u);
  EXPECT_EQ(a.encoded(), both.encoded());
  EXPECT_EQ(a.min(), 0);
  EXPECT_EQ(a.max(), 100'999);
  EXPECT_DOUBLE_EQ(a.mean(), both.mean());
}

TEST(HdrHistogram, SpectrumIsMonotonicUpToTheMaximum) {
  HdrHistogram h;
  for (int i = 1; i <= 5000; ++i) h.add(i);
  const std::string text = h.spectrum(1000);
  double last_value = 0, last_share = 0;
  int lines = 0;
  for (std::size_t at = text.find("\n\n") + 2; text[at] != '#'; at = text.find('\n', at) + 1) {
    double value = 0, share = 0;
    unsigned long long count = 0;
    ASSERT_EQ(std::sscanf(text.c_str() + at, "%lf %lf %llu", &value, &share, &count), 3);
    EXPECT_GE(value, last_value);
    EXPECT_GE(share, last_share);
    EXPECT_NEAR(static_cast<double>(count) / 5000, share, 1e-9);
    last_value = value;
    last_share = share;
    ++lines;
  }
  EXPECT_EQ(last_share, 1);
  EXPECT_NEAR(last_value, 5, 0.005);
  EXPECT_GT(lines, 20);
}

}  // namespace
}  // namespace eigencast::latency
