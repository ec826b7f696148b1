// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>

namespace eigencast {

/// Counts non-negative values in log-linear buckets: exact below 64, then 32 buckets for each power of two, so that a
/// percentile is at most 1/32 too high. Values from 2^40 up share the last bucket. After Gil Tene's HdrHistogram.
///
/// Not thread-safe. A fixed 9 KiB; add() is O(1) and never allocates.
class Histogram {
 public:
  /// Counts one value; a negative one is counted apart (negative()) and never hidden in a bucket.
  void add(std::int64_t value);

  std::uint64_t count() const { return count_; }
  std::uint64_t negative() const { return negative_; }
  std::int64_t max() const { return max_; }

  /// The upper edge of the bucket that holds the p-th percentile (never above max()); 0 when empty.
  /// REQUIRES: 0 <= p <= 100
  std::int64_t percentile(double p) const;

  void merge(const Histogram& other);
  void reset() { *this = Histogram(); }

 private:
  static constexpr int kSubBits = 5;
  static constexpr int kTopBit = 40;
  static constexpr int kBuckets = 64 + (kTopBit - 6) * (1 << kSubBits) + 1;

  static int bucket_of(std::int64_t value);
  static std::int64_t upper_edge_of(int bucket);

  std::array<std::uint64_t, kBuckets> buckets_{};
  std::uint64_t count_ = 0;
  std::uint64_t negative_ = 0;
  std::int64_t max_ = 0;
};

}  // namespace eigencast
