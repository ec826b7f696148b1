// SPDX-License-Identifier: MIT
// Exact runs (docs/protocol.md): Golomb-Rice codes of one band, after Golomb 1966, "Run-length encodings", and Rice
// 1979, "Some practical universal noiseless coding techniques".
#include <algorithm>
#include <bit>
#include <cassert>

#include "common/codec/band.h"
#include "common/codec/fixed.h"

namespace eigencast::band {
namespace {

constexpr std::uint8_t kExact = 0x80, kFromNewer = 0x20, kReserved = 0xc0;
constexpr unsigned kAllZero = 31;
constexpr unsigned kMaxParameter = 30;
constexpr unsigned kMaxQuotient = 24;
constexpr unsigned kEscapeBits = kMaxQuotient + 32;

class BitWriter {
 public:
  explicit BitWriter(Bytes& out) : out_(out) {}
  /// Appends the low `count` bits of `bits`, count <= 32.
  void put(std::uint64_t bits, unsigned count) {
    pending_ = pending_ << count | (bits & ((std::uint64_t{1} << count) - 1));
    for (filled_ += count; filled_ >= 8; filled_ -= 8)
      out_.push_back(static_cast<std::uint8_t>(pending_ >> (filled_ - 8)));
  }
  void pad() {
    if (filled_ > 0) put(0, 8 - filled_);
  }

 private:
  Bytes& out_;
  std::uint64_t pending_ = 0;
  unsigned filled_ = 0;
};

/// Reads beyond the end give ones, so that a unary run stops at its cap; see overran().
class BitReader {
 public:
  explicit BitReader(ByteView in) : in_(in) {}

  /// Counts ones up to the next zero, which is consumed too, or up to kMaxQuotient.
  unsigned unary() {
    fill();
    const unsigned ones = std::min(static_cast<unsigned>(std::countl_one(window_)), kMaxQuotient);
    drop(ones < kMaxQuotient ? ones + 1 : ones);
    return ones;
  }
  std::uint64_t bits(unsigned count) {  ///< count <= 32
    if (count == 0) return 0;
    fill();
    const std::uint64_t value = window_ >> (64 - count);
    drop(count);
    return value;
  }
  std::size_t bytes_taken() const { return (taken_ + 7) / 8; }
  bool overran() const { return taken_ > in_.size() * 8; }
  bool padding_is_zero() const { return taken_ % 8 == 0 || (in_[taken_ / 8] & (0xffu >> (taken_ % 8))) == 0; }

 private:
  void fill() {
    for (; filled_ <= 56; filled_ += 8, ++next_) {
      const std::uint64_t byte = next_ < in_.size() ? in_[next_] : 0xff;
      window_ |= byte << (56 - filled_);
    }
  }
  void drop(unsigned count) {
    window_ <<= count;
    filled_ -= count;
    taken_ += count;
  }

  ByteView in_;
  std::uint64_t window_ = 0;
  unsigned filled_ = 0;
  std::size_t next_ = 0;
  std::size_t taken_ = 0;
};

std::uint64_t cost(std::span<const std::uint64_t> z, unsigned parameter) {
  std::uint64_t bits = 0;
  for (const std::uint64_t value : z) {
    const std::uint64_t quotient = value >> parameter;
    bits += quotient < kMaxQuotient ? quotient + 1 + parameter : kEscapeBits;
  }
  return bits;
}

/// The optimum lies near log2 of the mean; outliers, which are escaped, raise the mean, so smaller parameters are tried
/// until the cost grows.
unsigned best_parameter(std::span<const std::uint64_t> z) {
  std::uint64_t sum = 0;
  for (const std::uint64_t value : z) sum += value;
  if (sum == 0) return kAllZero;
  const auto start = static_cast<unsigned>(std::bit_width(sum / z.size()));
  unsigned best = 0;
  std::uint64_t least = UINT64_MAX;
  for (unsigned parameter = std::min(start + 1, kMaxParameter);; --parameter) {
    const std::uint64_t bits = cost(z, parameter);
    if (bits > least) break;
    least = bits;
    best = parameter;
    if (parameter == 0) break;
  }
  return best;
}

}  // namespace

void append_exact(std::span<const std::int32_t> values, std::span<const std::int32_t> c1, Bytes& out) {
  assert(c1.empty() || c1.size() == values.size());
  std::vector<std::uint64_t> z(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) z[i] = zigzag(std::int64_t{values[i]} - (c1.empty() ? 0 : c1[i]));
  const unsigned parameter = best_parameter(z);
  out.push_back(static_cast<std::uint8_t>(kExact | (c1.empty() ? 0u : kFromNewer) | parameter));
  if (parameter == kAllZero) return;
  BitWriter writer(out);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::uint64_t quotient = z[i] >> parameter;
    if (quotient < kMaxQuotient) {
      writer.put((std::uint64_t{2} << quotient) - 2, static_cast<unsigned>(quotient) + 1);
      writer.put(z[i], parameter);
    } else {
      writer.put((std::uint64_t{1} << kMaxQuotient) - 1, kMaxQuotient);
      writer.put(static_cast<std::uint32_t>(values[i]), 32);
    }
  }
  writer.pad();
}

Result<std::size_t> read_exact(ByteView in, std::span<const std::int32_t> c1, std::span<std::int32_t> values) {
  const auto corrupt = [](const char* what) { return fail(ErrorCode::kCorrupt, what); };
  if (in.empty()) return corrupt("its head is missing");
  if ((in[0] & kReserved) != kExact) return corrupt("reserved bits are not as they must be");
  const bool from_newer = (in[0] & kFromNewer) != 0;
  if (from_newer && c1.empty()) return corrupt("an exact run needs a key that the receiver lacks");
  const unsigned parameter = in[0] & 31u;

  BitReader reader(in.subspan(1));
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::int64_t value = from_newer ? c1[i] : 0;
    if (parameter != kAllZero) {
      const std::uint64_t quotient = reader.unary();
      if (quotient < kMaxQuotient) {
        value += unzigzag(quotient << parameter | reader.bits(parameter));
      } else {
        value = static_cast<std::int32_t>(static_cast<std::uint32_t>(reader.bits(32)));
      }
      if (reader.overran()) return corrupt("its bits end early");
    }
    if (!fixed::in_range(value)) return corrupt("a value leaves +-2^30");
    values[i] = static_cast<std::int32_t>(value);
  }
  if (!reader.padding_is_zero()) return corrupt("padding bits are set");
  return 1 + reader.bytes_taken();
}

Result<std::size_t> read(ByteView in, const References& from, const Spacing& spacing, std::span<std::int32_t> values) {
  if (spacing.half == 0) return read_exact(in, from.c1, values);
  if (in.empty() || in[0] != kExactFollows) return read_coarse(in, from, spacing, values);
  const auto taken = read_exact(in.subspan(1), from.c1, values);
  if (!taken) return taken.error();
  return 1 + *taken;
}

}  // namespace eigencast::band
