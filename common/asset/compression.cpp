// SPDX-License-Identifier: MIT
#include "common/asset/compression.h"

#include <zstd.h>

#include <string>

namespace eigencast {
namespace {

/// Level 12 gains 3 % over the default on basis tiles and decodes at the same speed; assets are written once and read
/// often.
constexpr int kLevel = 12;

}  // namespace

Result<Bytes> zstd_compress(ByteView raw) {
  Bytes packed(ZSTD_compressBound(raw.size()));
  const std::size_t size = ZSTD_compress(packed.data(), packed.size(), raw.data(), raw.size(), kLevel);
  if (ZSTD_isError(size) != 0) {
    return fail(ErrorCode::kInternal, std::string("zstd could not compress: ") + ZSTD_getErrorName(size));
  }
  packed.resize(size);
  packed.shrink_to_fit();
  return packed;
}

Result<Bytes> zstd_decompress(ByteView packed, std::size_t raw_size) {
  if (ZSTD_getFrameContentSize(packed.data(), packed.size()) != raw_size) {
    return fail(ErrorCode::kCorrupt,
                "its zstd frame does not state the " + std::to_string(raw_size) + " bytes that the manifest promises");
  }
  // Several frames in a row would decompress too; the format allows one.
  const std::size_t frame_size = ZSTD_findFrameCompressedSize(packed.data(), packed.size());
  if (ZSTD_isError(frame_size) != 0 || frame_size != packed.size()) {
    return fail(ErrorCode::kCorrupt, "it is not exactly one whole zstd frame");
  }
  Bytes raw(raw_size);
  const std::size_t size = ZSTD_decompress(raw.data(), raw.size(), packed.data(), packed.size());
  if (ZSTD_isError(size) != 0) {
    return fail(ErrorCode::kCorrupt, std::string("zstd refuses it: ") + ZSTD_getErrorName(size));
  }
  if (size != raw_size) return fail(ErrorCode::kCorrupt, "its zstd frame is shorter than it states");
  return raw;
}

}  // namespace eigencast
