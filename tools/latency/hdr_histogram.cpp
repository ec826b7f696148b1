// SPDX-License-Identifier: MIT
#include "tools/latency/hdr_histogram.h"

#include <zlib.h>

#include <bit>
#include <cassert>
#include <cmath>

#include "common/core/bytes.h"
#include "common/core/text.h"

namespace eigencast::latency {
namespace {

constexpr std::uint32_t kCookie = 0x1c849303 | 0x10;            // V2, counts as ZigZag LEB128.
constexpr std::uint32_t kCompressedCookie = 0x1c849304 | 0x10;  // The same, deflated.

void big_endian(std::uint64_t value, int bytes, Bytes& out) {
  for (int i = bytes - 1; i >= 0; --i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

// Differs from varint: its ninth byte, if any, holds eight bits.
void add_signed(std::int64_t value, Bytes& out) {
  std::uint64_t v = zigzag(value);
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

std::optional<std::int64_t> HdrHistogram::reliable_percentile(double p) const {
  if (count() == 0) return std::nullopt;
  if (p == 100) return max();
  const auto all = static_cast<double>(count() + negative());
  if ((1 - p / 100) * all < kSamplesBeyond * (1 - 1e-9)) return std::nullopt;
  const double beyond_negative = p / 100 * all - static_cast<double>(negative());
  if (negative() > 0 && beyond_negative <= 0) return std::nullopt;
  return percentile(std::clamp(beyond_negative / static_cast<double>(count()) * 100, 0.0, 100.0));
}

std::string HdrHistogram::spectrum(double unit_us) const {
  std::string text = formatted("%12s %14s %10s %14s\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
  std::uint64_t seen = 0;
  double next = 0;
  for (std::size_t i = 0; i < buckets().size() && count() > 0; ++i) {
    seen += buckets()[i];
    const double reached = 100.0 * static_cast<double>(seen) / static_cast<double>(count());
    if (buckets()[i] == 0 || (reached < next && seen < count())) continue;
    const double value = static_cast<double>(std::min(upper_edge_of(i), max())) / unit_us;
    if (seen == count()) {
      text += formatted("%12.3f %2.12f %10llu\n", value, 1.0, static_cast<unsigned long long>(seen));
      break;
    }
    text += formatted("%12.3f %2.12f %10llu %14.2f\n", value, reached / 100, static_cast<unsigned long long>(seen),
                      1 / (1 - reached / 100));
    // Five steps for each halving of what is left, as HdrHistogram's tools have it.
    const double halvings = std::floor(std::log2(100 / (100 - reached))) + 1;
    next = reached + 100 / (5 * std::exp2(halvings));
  }
  text += formatted("#[Mean    = %12.3f, StdDeviation   = %12.3f]\n", mean() / unit_us, standard_deviation() / unit_us);
  text += formatted("#[Max     = %12.3f, Total count    = %12llu]\n", static_cast<double>(max()) / unit_us,
                    static_cast<unsigned long long>(count()));
  text += formatted("#[Buckets = %12d, SubBuckets     = %12d]\n", 22, 1 << kPrecisionBits);
  return text;
}

std::string HdrHistogram::encoded() const {
  Bytes counts;
  std::size_t end = buckets().size();
  while (end > 0 && buckets()[end - 1] == 0) --end;
  for (std::size_t i = 0; i < end;) {
    std::size_t zeros = 0;
    while (i + zeros < end && buckets()[i + zeros] == 0) ++zeros;
    if (zeros > 0) {
      add_signed(zeros == 1 ? 0 : -static_cast<std::int64_t>(zeros), counts);
      i += zeros;
    } else {
      add_signed(static_cast<std::int64_t>(buckets()[i++]), counts);
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
