// SPDX-License-Identifier: MIT
#include "tools/latency/hdr_histogram.h"

#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>

#include "common/core/base64.h"
#include "common/core/bytes.h"
#include "common/core/text.h"

namespace eigencast::latency {
namespace {

constexpr std::uint32_t kCookie = 0x1c849303 | 0x10;            // V2, counts as ZigZag LEB128.
constexpr std::uint32_t kCompressedCookie = 0x1c849304 | 0x10;  // The same, deflated.

void big_endian(std::uint64_t value, int bytes, Bytes& out) {
  for (int i = bytes - 1; i >= 0; --i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

// As varint, but its ninth byte, if any, holds eight bits.
void zigzag(std::int64_t value, Bytes& out) {
  std::uint64_t v = (static_cast<std::uint64_t>(value) << 1) ^ static_cast<std::uint64_t>(value >> 63);
  for (int i = 0; i < 8 && v >= 0x80; ++i, v >>= 7) out.push_back(static_cast<std::uint8_t>(v | 0x80));
  out.push_back(static_cast<std::uint8_t>(v));
}

Bytes deflated(const Bytes& bytes) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  Bytes out(size);
  const int done = compress(out.data(), &size, bytes.data(), static_cast<uLong>(bytes.size()));
  assert(done == Z_OK);
  (void)done;
  out.resize(size);
  return out;
}

}  // namespace

std::size_t HdrHistogram::index_of(std::int64_t value) {
  // Values below 2,048 have a bucket each; from there on the upper half of the sub-buckets covers each power of two.
  const auto v = static_cast<std::uint64_t>(value);
  const int bucket = std::max(0, static_cast<int>(std::bit_width(v)) - kSubBucketBits);
  const std::size_t sub = v >> bucket;
  return (static_cast<std::size_t>(bucket) << (kSubBucketBits - 1)) + sub;
}

std::int64_t HdrHistogram::highest_of(std::size_t index) {
  constexpr std::size_t kHalf = std::size_t{1} << (kSubBucketBits - 1);
  if (index < 2 * kHalf) return static_cast<std::int64_t>(index);
  const std::size_t bucket = index / kHalf - 1;
  const std::size_t sub = index % kHalf + kHalf;
  return static_cast<std::int64_t>(((sub + 1) << bucket) - 1);
}

void HdrHistogram::add(std::int64_t value_us) {
  if (value_us < 0) return void(++negative_);
  const std::int64_t value = std::min(value_us, kHighest);
  const std::size_t index = index_of(value);
  if (index >= counts_.size()) counts_.resize(std::bit_ceil(index + 1));
  ++counts_[index];
  min_ = count_ == 0 ? value : std::min(min_, value);
  max_ = std::max(max_, value);
  sum_ += static_cast<double>(value);
  sum_of_squares_ += static_cast<double>(value) * static_cast<double>(value);
  ++count_;
}

void HdrHistogram::merge(const HdrHistogram& other) {
  if (counts_.size() < other.counts_.size()) counts_.resize(other.counts_.size());
  for (std::size_t i = 0; i < other.counts_.size(); ++i) counts_[i] += other.counts_[i];
  if (other.count_ > 0) min_ = count_ == 0 ? other.min_ : std::min(min_, other.min_);
  max_ = std::max(max_, other.max_);
  count_ += other.count_;
  negative_ += other.negative_;
  sum_ += other.sum_;
  sum_of_squares_ += other.sum_of_squares_;
}

std::int64_t HdrHistogram::percentile(double p) const {
  assert(p >= 0 && p <= 100);
  if (count_ == 0) return 0;
  const auto rank =
      std::max<std::uint64_t>(1, static_cast<std::uint64_t>(std::ceil(p / 100 * static_cast<double>(count_))));
  std::uint64_t seen = 0;
  for (std::size_t i = 0; i < counts_.size(); ++i) {
    seen += counts_[i];
    if (seen >= rank) return std::min(highest_of(i), max_);
  }
  return max_;
}

std::optional<std::int64_t> HdrHistogram::reliable_percentile(double p) const {
  if (count_ == 0) return std::nullopt;
  if (p == 100) return max_;
  const auto all = static_cast<double>(count_ + negative_);
  if ((1 - p / 100) * all < kSamplesBeyond * (1 - 1e-9)) return std::nullopt;
  const double beyond_negative = p / 100 * all - static_cast<double>(negative_);
  if (negative_ > 0 && beyond_negative <= 0) return std::nullopt;
  return percentile(std::clamp(beyond_negative / static_cast<double>(count_) * 100, 0.0, 100.0));
}

std::string HdrHistogram::spectrum(double unit_us) const {
  std::string text = formatted("%12s %14s %10s %14s\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
  std::uint64_t seen = 0;
  double next = 0;
  for (std::size_t i = 0; i < counts_.size() && count_ > 0; ++i) {
    seen += counts_[i];
    const double reached = 100.0 * static_cast<double>(seen) / static_cast<double>(count_);
    if (counts_[i] == 0 || (reached < next && seen < count_)) continue;
    const double value = static_cast<double>(std::min(highest_of(i), max_)) / unit_us;
    if (seen == count_) {
      text += formatted("%12.3f %2.12f %10llu\n", value, 1.0, static_cast<unsigned long long>(seen));
      break;
    }
    text += formatted("%12.3f %2.12f %10llu %14.2f\n", value, reached / 100, static_cast<unsigned long long>(seen),
                      1 / (1 - reached / 100));
    // Five steps for each halving of what is left, as HdrHistogram's tools have it.
    const double halvings = std::floor(std::log2(100 / (100 - reached))) + 1;
    next = reached + 100 / (5 * std::exp2(halvings));
  }
  const double n = static_cast<double>(std::max<std::uint64_t>(1, count_));
  const double deviation = std::sqrt(std::max(0.0, sum_of_squares_ / n - mean() * mean()));
  text += formatted("#[Mean    = %12.3f, StdDeviation   = %12.3f]\n", mean() / unit_us, deviation / unit_us);
  text += formatted("#[Max     = %12.3f, Total count    = %12llu]\n", static_cast<double>(max_) / unit_us,
                    static_cast<unsigned long long>(count_));
  text += formatted("#[Buckets = %12d, SubBuckets     = %12d]\n", 22, 1 << kSubBucketBits);
  return text;
}

std::string HdrHistogram::encoded() const {
  Bytes counts;
  std::size_t end = counts_.size();
  while (end > 0 && counts_[end - 1] == 0) --end;
  for (std::size_t i = 0; i < end;) {
    std::size_t zeros = 0;
    while (i + zeros < end && counts_[i + zeros] == 0) ++zeros;
    if (zeros > 0) {
      zigzag(zeros == 1 ? 0 : -static_cast<std::int64_t>(zeros), counts);
      i += zeros;
    } else {
      zigzag(static_cast<std::int64_t>(counts_[i++]), counts);
    }
  }
  Bytes plain;
  big_endian(kCookie, 4, plain);
  big_endian(counts.size(), 4, plain);
  big_endian(0, 4, plain);  // Normalising index offset.
  big_endian(3, 4, plain);  // Significant digits.
  big_endian(1, 8, plain);  // Lowest discernible value.
  big_endian(static_cast<std::uint64_t>(kHighest), 8, plain);
  big_endian(std::bit_cast<std::uint64_t>(1.0), 8, plain);  // Integer to double ratio.
  plain.insert(plain.end(), counts.begin(), counts.end());
  const Bytes packed = deflated(plain);
  Bytes all;
  big_endian(kCompressedCookie, 4, all);
  big_endian(packed.size(), 4, all);
  all.insert(all.end(), packed.begin(), packed.end());
  return base64_from_bytes(all);
}

std::string histogram_log(const std::vector<LogInterval>& intervals, double start_unix_s) {
  std::string text = "#[Histogram log format version 1.3]\n";
  text += "#[values in microseconds]\n";
  text += formatted("#[StartTime: %.3f (seconds since epoch)]\n", start_unix_s);
  text += "\"StartTimestamp\",\"Interval_Length\",\"Interval_Max\",\"Interval_Compressed_Histogram\"\n";
  for (const LogInterval& interval : intervals) {
    if (!interval.tag.empty()) text += "Tag=" + interval.tag + ",";
    text +=
        formatted("%.3f,%.3f,%.3f,", static_cast<double>(interval.start_us) / 1e6,
                  static_cast<double>(interval.length_us) / 1e6, static_cast<double>(interval.histogram.max()) / 1e3);
    text += interval.histogram.encoded() + "\n";
  }
  return text;
}

}  // namespace eigencast::latency
