// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>

#include "common/asset/asset.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// The decompressed tile has one of these two sizes: of offsets along one axis, and along three.
///   first_row  of the chunk: the first chunk's tile states what is true of all
std::uint64_t detail_bytes(std::uint64_t rows, std::uint32_t first_row, std::uint32_t rank, std::uint32_t axes);

/// Offsets of an asset whose basis is replaced by another, so that the rest pose stays where it is.
///   basis      n x r, row-major: the one that readers have
Asset::Detail detail_on_basis(const Asset& asset, std::span<const float> basis);

/// The detail of rows [first_row, first_row + map.size()) of an asset that has it.
///   map  of those rows
Bytes encode_detail(const Asset::Detail& detail, std::uint32_t first_row, std::span<const std::uint32_t> map);

/// Adds as many rows as `map` has. Safe on hostile input; after an error nothing has changed. Errors: kCorrupt.
/// REQUIRES: detail.size() rows are there.
Result<void> decode_detail(ByteView raw, std::uint32_t rank, std::span<const std::uint32_t> map, Asset::Detail& detail);

}  // namespace eigencast
