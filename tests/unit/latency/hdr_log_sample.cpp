// SPDX-License-Identifier: MIT
// Prints an HdrHistogram log and, as the lines before it, what a reader must find in it: tag, count, p50, p99, max.

#include <cstdio>

#include "tools/latency/hdr_histogram.h"

int main() {
  using namespace eigencast::latency;
  std::vector<LogInterval> intervals(3);
  intervals[0] = {"key", 0, 1'000'000, {}};
  intervals[1] = {"synthetic", 0, 1'000'000, {}};
  intervals[2] = {"key", 1'000'000, 1'000'000, {}};
  for (int i = 1; i <= 10'000; ++i) intervals[0].histogram.add(i);
  for (int i = 0; i < 1000; ++i) intervals[1].histogram.add(i * i * 3);
  intervals[2].histogram.add(0);
  intervals[2].histogram.add(HdrHistogram::kHighest);
  for (int i = 0; i < 98; ++i) intervals[2].histogram.add(2047 + i % 3);
  for (const LogInterval& interval : intervals) {
    const HdrHistogram& h = interval.histogram;
    std::printf("%s %llu %lld %lld %lld\n", interval.tag.c_str(), static_cast<unsigned long long>(h.count()),
                static_cast<long long>(h.percentile(50)), static_cast<long long>(h.percentile(99)),
                static_cast<long long>(h.max()));
  }
  std::fputs(histogram_log(intervals, 1.5e9).c_str(), stdout);
}
