// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/asset/asset.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// Bounds on the decompressed tile.
std::uint64_t min_splat_bytes(std::uint64_t rows);
std::uint64_t max_splat_bytes(std::uint64_t rows);

/// The splats of rows [first_row, end_row) of an asset that has them.
///   diagonal  of the rest box: radii are in units of it
Bytes encode_splats(const Asset::Splats& splats, std::uint32_t first_row, std::uint32_t end_row,
                    std::uint32_t base_count, double diagonal);

/// Adds the rows from splats.size() to end_row. Safe on hostile input: frames come before what they turn, normals are
/// of unit length. After an error nothing has changed. Errors: kCorrupt.
Result<void> decode_splats(ByteView raw, std::uint32_t end_row, std::uint32_t base_count, double diagonal,
                           Asset::Splats& splats);

}  // namespace eigencast
