// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// How the bytes of a tile are kept. kCoded: basis tiles only (basis_tile.h).
enum class Compression : std::uint8_t { kStored = 0, kZstd = 1, kCoded = 2 };

/// One zstd frame with its content size; deterministic for one version of the library only. Errors: kInternal.
Result<Bytes> zstd_compress(ByteView raw);

/// Safe on hostile input: allocates for one whole frame of exactly `raw_size` bytes only. Errors: kCorrupt.
Result<Bytes> zstd_decompress(ByteView packed, std::size_t raw_size);

}  // namespace eigencast
