// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/core/bytes.h"

/// A binary arithmetic coder with fixed probabilities (docs/protocol.md, "Range coder"). Source: Martin 1979, "Range
/// encoding: an algorithm for removing redundancy from a digitised message". Bytes beyond the end read as 0, so the
/// encoder omits trailing zeros. Hot loops take a coder by value, which keeps it in registers.
namespace eigencast::band {

inline constexpr std::uint32_t kProbabilityBits = 15;
/// The first interval excludes the last byte: an encoder never writes 255 first.
inline constexpr std::uint32_t kFirstRange = 0xff000000u;

class RangeEncoder {
 public:
  explicit RangeEncoder(Bytes& out) : out_(out), begin_(out.size()) {}

  /// Codes a decision of probability p / 2^15, 0 < p < 2^15.
  void put(bool decision, std::uint32_t p) {
    const std::uint32_t bound = (range_ >> kProbabilityBits) * p;
    low_ += decision ? 0 : bound;
    range_ = decision ? bound : range_ - bound;
    while (range_ < kBottom) shift();
  }
  void put_even(bool decision) { put(decision, 1u << (kProbabilityBits - 1)); }

  /// Ends the run: the shortest bytes that, followed by zeros, lie within the interval.
  void finish() {
    std::uint64_t value = low_;
    for (unsigned bits = 32; bits > 0; bits -= 8) {
      const std::uint64_t mask = (std::uint64_t{1} << bits) - 1;
      value = (low_ + mask) & ~mask;
      if (value < low_ + range_) break;
      value = low_;
    }
    low_ = value;
    for (int byte = 0; byte < 4; ++byte) shift();
    while (out_.size() > begin_ && out_.back() == 0) out_.pop_back();
  }

 private:
  /// Moves the highest byte out; the bit above it is a carry into the bytes before.
  [[gnu::always_inline]] void shift() {
    if (low_ >> 32 != 0) carry(out_);
    out_.push_back(static_cast<std::uint8_t>(low_ >> 24));
    low_ = (low_ << 8) & 0xffffffffu;
    range_ <<= 8;
  }
  /// Some byte takes the carry: the interval never leaves [0, 1).
  static void carry(Bytes& out) {
    for (std::size_t i = out.size(); ++out[--i] == 0;) {
    }
  }

  static constexpr std::uint32_t kBottom = 1u << 24;
  Bytes& out_;
  std::size_t begin_;
  std::uint64_t low_ = 0;
  std::uint32_t range_ = kFirstRange;
};

class RangeDecoder {
 public:
  explicit RangeDecoder(ByteView in) : in_(in) {
    for (int i = 0; i < 4; ++i) take_byte();
  }

  bool get(std::uint32_t p) {
    const std::uint32_t bound = (range_ >> kProbabilityBits) * p;
    const bool decision = code_ < bound;
    code_ -= decision ? 0 : bound;
    range_ = decision ? bound : range_ - bound;
    while (range_ < kBottom) {
      range_ <<= 8;
      take_byte();
    }
    return decision;
  }
  bool get_even() { return get(1u << (kProbabilityBits - 1)); }

  /// Whether all bytes were read and the last one is not a zero that an encoder would have omitted.
  bool finished() const { return in_.size() <= next_ && (in_.empty() || in_.back() != 0); }

 private:
  void take_byte() {
    code_ = code_ << 8 | (next_ < in_.size() ? in_[next_] : 0u);
    ++next_;
  }

  static constexpr std::uint32_t kBottom = 1u << 24;
  ByteView in_;
  std::size_t next_ = 0;
  std::uint32_t code_ = 0;
  std::uint32_t range_ = kFirstRange;
};

}  // namespace eigencast::band
