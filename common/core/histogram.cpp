// SPDX-License-Identifier: MIT
#include "common/core/histogram.h"

#include <bit>
#include <cmath>

namespace eigencast {

std::size_t Histogram::bucket_of(std::int64_t value) const {
  const auto v = static_cast<std::uint64_t>(value);
  const int shift = std::max(0, static_cast<int>(std::bit_width(v)) - precision_bits_);
  return (static_cast<std::size_t>(shift) << (precision_bits_ - 1)) + (v >> shift);
}

std::int64_t Histogram::upper_edge_of(std::size_t bucket) const {
  const std::size_t half = std::size_t{1} << (precision_bits_ - 1);
  if (bucket < 2 * half) return static_cast<std::int64_t>(bucket);
  const std::size_t shift = bucket / half - 1;
  return static_cast<std::int64_t>(((bucket % half + half + 1) << shift) - 1);
}

void Histogram::add(std::int64_t value) {
  if (value < 0) return void(++negative_);
  const std::size_t bucket = bucket_of(value);
  if (bucket >= buckets_.size()) buckets_.resize(std::bit_ceil(bucket + 1));
  ++buckets_[bucket];
  min_ = count_ == 0 ? value : std::min(min_, value);
  max_ = std::max(max_, value);
  sum_ += static_cast<double>(value);
  sum_of_squares_ += static_cast<double>(value) * static_cast<double>(value);
  ++count_;
}

double Histogram::standard_deviation() const {
  const double n = static_cast<double>(std::max<std::uint64_t>(1, count_));
  return std::sqrt(std::max(0.0, sum_of_squares_ / n - mean() * mean()));
}

std::int64_t Histogram::percentile(double p) const {
  assert(p >= 0 && p <= 100);
  if (count_ == 0) return 0;
  const auto rank =
      std::max<std::uint64_t>(1, static_cast<std::uint64_t>(std::ceil(p / 100 * static_cast<double>(count_))));
  std::uint64_t seen = 0;
  for (std::size_t bucket = 0; bucket < buckets_.size(); ++bucket) {
    seen += buckets_[bucket];
    if (seen >= rank) return std::min(upper_edge_of(bucket), max_);
  }
  return max_;
}

void Histogram::merge(const Histogram& other) {
  assert(precision_bits_ == other.precision_bits_);
  if (buckets_.size() < other.buckets_.size()) buckets_.resize(other.buckets_.size());
  for (std::size_t i = 0; i < other.buckets_.size(); ++i) buckets_[i] += other.buckets_[i];
  if (other.count_ > 0) min_ = count_ == 0 ? other.min_ : std::min(min_, other.min_);
  max_ = std::max(max_, other.max_);
  count_ += other.count_;
  negative_ += other.negative_;
  sum_ += other.sum_;
  sum_of_squares_ += other.sum_of_squares_;
}

}  // namespace eigencast
