// SPDX-License-Identifier: MIT
#include "common/core/histogram.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>

namespace eigencast {

int Histogram::bucket_of(std::int64_t value) {
  if (value < 64) return static_cast<int>(value);
  const auto v = static_cast<std::uint64_t>(value);
  const int top = static_cast<int>(std::bit_width(v)) - 1;  // >= 6
  if (top >= kTopBit) return kBuckets - 1;
  const int sub = static_cast<int>((v >> (top - kSubBits)) & ((1u << kSubBits) - 1));
  return 64 + (top - 6) * (1 << kSubBits) + sub;
}

std::int64_t Histogram::upper_edge_of(int bucket) {
  if (bucket < 64) return bucket;
  const int top = 6 + (bucket - 64) / (1 << kSubBits);
  const int sub = (bucket - 64) % (1 << kSubBits);
  const std::int64_t width = std::int64_t{1} << (top - kSubBits);
  return (std::int64_t{1} << top) + (sub + 1) * width - 1;
}

void Histogram::add(std::int64_t value) {
  if (value < 0) {
    ++negative_;
    return;
  }
  ++buckets_[static_cast<std::size_t>(bucket_of(value))];
  ++count_;
  max_ = std::max(max_, value);
}

std::int64_t Histogram::percentile(double p) const {
  assert(p >= 0 && p <= 100);
  if (count_ == 0) return 0;
  const auto rank =
      std::max<std::uint64_t>(1, static_cast<std::uint64_t>(std::ceil(p / 100 * static_cast<double>(count_))));
  std::uint64_t seen = 0;
  for (int b = 0; b < kBuckets; ++b) {
    seen += buckets_[static_cast<std::size_t>(b)];
    if (seen >= rank) return b == kBuckets - 1 ? max_ : std::min(upper_edge_of(b), max_);
  }
  return max_;
}

void Histogram::merge(const Histogram& other) {
  for (std::size_t b = 0; b < buckets_.size(); ++b) buckets_[b] += other.buckets_[b];
  count_ += other.count_;
  negative_ += other.negative_;
  max_ = std::max(max_, other.max_);
}

}  // namespace eigencast
