// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace eigencast {

/// Counts non-negative values in log-linear buckets: exact below 2^precision_bits, then half as many buckets for each
/// power of two, so that a percentile is at most 2^(1 - precision_bits) of itself too high. The layout is that of Gil
/// Tene's HdrHistogram.
///
/// Not thread-safe. add() is O(1) and allocates at most once per power of two.
class Histogram {
 public:
  Histogram() = default;
  explicit Histogram(int precision_bits) : precision_bits_(precision_bits) {}

  /// Counts one value; a negative one is counted apart and never hidden in a bucket.
  void add(std::int64_t value);

  std::uint64_t count() const { return count_; }        ///< Counts values that are not negative.
  std::uint64_t negative() const { return negative_; }  ///< Counts those that are.
  std::int64_t min() const { return count_ == 0 ? 0 : min_; }
  std::int64_t max() const { return max_; }
  double mean() const { return count_ == 0 ? 0 : sum_ / static_cast<double>(count_); }
  /// Describes the population, not a sample.
  double standard_deviation() const;

  /// The upper edge of the bucket that holds the p-th percentile (never above max()); 0 when empty.
  /// REQUIRES: 0 <= p <= 100
  std::int64_t percentile(double p) const;

  /// The counts of the buckets, and the highest value of each.
  const std::vector<std::uint64_t>& buckets() const { return buckets_; }
  std::int64_t upper_edge_of(std::size_t bucket) const;

  /// REQUIRES: both have the same precision.
  void merge(const Histogram& other);
  void reset() { *this = Histogram(precision_bits_); }

 private:
  std::size_t bucket_of(std::int64_t value) const;

  int precision_bits_ = 6;
  std::vector<std::uint64_t> buckets_;
  std::uint64_t count_ = 0, negative_ = 0;
  std::int64_t min_ = 0, max_ = 0;
  double sum_ = 0, sum_of_squares_ = 0;
};

/// The value in the middle, of an even number the larger of the two. O(n). REQUIRES: at least one, none of them NaN.
template <class T>
T median(std::vector<T> values) {
  assert(!values.empty());
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace eigencast
