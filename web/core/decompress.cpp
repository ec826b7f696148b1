// SPDX-License-Identifier: MIT
//
// The checks of common/asset/tiles/compression.cpp round a decompressor that is imported (RFC 8878).
#include <bit>
#include <cstdint>
#include <optional>
#include <string>

#include "common/asset/tiles/compression.h"

extern "C" __attribute__((import_module("env"), import_name("zstd_decompress"))) std::int32_t zstd_decompress_import(
    const std::uint8_t* from, std::uint32_t size, std::uint8_t* to, std::uint32_t room);

namespace eigencast {
namespace {

constexpr std::uint32_t kMagic = 0xFD2FB528;

/// The content size that the frame's header states, which is left behind; nothing: none, or not a plain frame.
std::optional<std::uint64_t> content_size(ByteReader& in, bool& has_checksum) {
  if (in.u32() != kMagic) return std::nullopt;
  const std::uint8_t descriptor = in.u8();
  const bool single_segment = (descriptor & 0x20) != 0;
  has_checksum = (descriptor & 4) != 0;
  if ((descriptor & 0x0b) != 0) return std::nullopt;  // A dictionary, or a reserved bit.
  if (!single_segment) in.u8();                       // The window's size.
  const unsigned code = descriptor >> 6;
  if (code == 0) return single_segment ? std::optional<std::uint64_t>(in.u8()) : std::nullopt;
  if (code == 1) return std::uint64_t{in.u16()} + 256;
  return code == 2 ? std::uint64_t{in.u32()} : in.u64();
}

/// Whether blocks, up to the last one, and a checksum are all that follows.
bool ends_with_its_blocks(ByteReader& in, bool has_checksum) {
  for (bool last = false; !last && !in.failed();) {
    const ByteView head = in.bytes(3);
    if (head.size() < 3) return false;
    const std::uint32_t bits = head[0] | std::uint32_t{head[1]} << 8 | std::uint32_t{head[2]} << 16;
    last = (bits & 1) != 0;
    const std::uint32_t type = bits >> 1 & 3, size = bits >> 3;
    if (type == 3) return false;
    in.bytes(type == 1 ? 1 : size);
  }
  if (has_checksum) in.bytes(4);
  return in.finished();
}

}  // namespace

Result<Bytes> zstd_decompress(ByteView packed, std::size_t raw_size) {
  ByteReader in(packed);
  bool has_checksum = false;
  const auto stated = content_size(in, has_checksum);
  if (in.failed() || stated != std::uint64_t{raw_size}) {
    return fail(ErrorCode::kCorrupt,
                "its zstd frame does not state the " + std::to_string(raw_size) + " bytes that the manifest promises");
  }
  if (!ends_with_its_blocks(in, has_checksum))
    return fail(ErrorCode::kCorrupt, "it is not exactly one whole zstd frame");
  Bytes raw(raw_size);
  const std::int32_t size = zstd_decompress_import(packed.data(), static_cast<std::uint32_t>(packed.size()), raw.data(),
                                                   static_cast<std::uint32_t>(raw_size));
  if (size < 0 || static_cast<std::size_t>(size) != raw_size)
    return fail(ErrorCode::kCorrupt, "its zstd frame cannot be decompressed");
  return raw;
}

}  // namespace eigencast
