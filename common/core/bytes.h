// SPDX-License-Identifier: MIT
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <vector>

namespace eigencast {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

/// Appends little-endian values to a byte vector, which it borrows for its lifetime. Not thread-safe.
class ByteWriter {
 public:
  explicit ByteWriter(Bytes& out) : out_(out) {}

  void u8(std::uint8_t v) { out_.push_back(v); }
  void u16(std::uint16_t v) { little_endian(v, 2); }
  void u32(std::uint32_t v) { little_endian(v, 4); }
  void u64(std::uint64_t v) { little_endian(v, 8); }
  void f32(float v) { u32(std::bit_cast<std::uint32_t>(v)); }
  void f64(double v) { u64(std::bit_cast<std::uint64_t>(v)); }
  void varint(std::uint64_t v) {  ///< LEB128: 7 bits a byte, low first, high bit = more follow; 1 to 10 bytes.
    for (; v >= 0x80; v >>= 7) u8(static_cast<std::uint8_t>(v | 0x80));
    u8(static_cast<std::uint8_t>(v));
  }
  void bytes(ByteView v) { append(v.data(), v.size()); }
  void text(std::string_view v) { append(v.data(), v.size()); }
  std::size_t size() const { return out_.size(); }

 private:
  // Not vector::insert: g++ 12 sees an overlap in it that cannot be (-Warray-bounds).
  void append(const void* data, std::size_t size) {
    if (size == 0) return;
    const std::size_t at = out_.size();
    out_.resize(at + size);
    std::memcpy(out_.data() + at, data, size);
  }
  void little_endian(std::uint64_t v, int count) {
    for (int i = 0; i < count; ++i) out_.push_back(static_cast<std::uint8_t>(v >> (8 * i)));
  }
  Bytes& out_;
};

/// Reads little-endian values from bytes that it borrows. Safe on hostile input: a read past the end returns 0 and sets
/// failed(), and so does everything after it, so that a parser may check once at its end. Not thread-safe.
class ByteReader {
 public:
  explicit ByteReader(ByteView in) : in_(in) {}

  std::uint8_t u8() { return little_endian<std::uint8_t>(); }
  std::uint16_t u16() { return little_endian<std::uint16_t>(); }
  std::uint32_t u32() { return little_endian<std::uint32_t>(); }
  std::uint64_t u64() { return little_endian<std::uint64_t>(); }
  float f32() { return std::bit_cast<float>(u32()); }
  double f64() { return std::bit_cast<double>(u64()); }
  /// LEB128; a value of more than 64 bits or with a superfluous last byte of zero fails.
  std::uint64_t varint();
  /// A view of the next `count` bytes; empty and failed() when there are fewer.
  ByteView bytes(std::size_t count) {
    if (failed_ || count > in_.size() - at_) {
      failed_ = true;
      return {};
    }
    const ByteView view = in_.subspan(at_, count);
    at_ += count;
    return view;
  }

  std::size_t position() const { return at_; }
  std::size_t remaining() const { return failed_ ? 0 : in_.size() - at_; }
  bool failed() const { return failed_; }
  /// Everything was read and nothing failed.
  bool finished() const { return !failed_ && at_ == in_.size(); }

 private:
  template <typename Unsigned>
  Unsigned little_endian() {
    static_assert(std::endian::native == std::endian::little);
    Unsigned value = 0;
    if (const ByteView from = bytes(sizeof value); !from.empty()) std::memcpy(&value, from.data(), sizeof value);
    return value;
  }
  ByteView in_;
  std::size_t at_ = 0;
  bool failed_ = false;
};

/// Signed numbers as unsigned ones, small magnitudes first: 0, -1, 1, -2, ...
inline std::uint64_t zigzag(std::int64_t v) {
  return (static_cast<std::uint64_t>(v) << 1) ^ static_cast<std::uint64_t>(v >> 63);
}
inline std::int64_t unzigzag(std::uint64_t v) {
  return static_cast<std::int64_t>(v >> 1) ^ -static_cast<std::int64_t>(v & 1);
}

}  // namespace eigencast
