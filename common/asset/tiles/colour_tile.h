// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/core/bytes.h"

namespace eigencast {

/// Bytes of the tile of colours of so many rows, decompressed.
std::uint64_t colour_bytes(std::uint64_t rows);

/// The colours of rows [first_row, first_row + map.size()), each as what it differs by from the row that it contracts
/// onto.
///   map         of those rows; a row that is its own parent is predicted from the row before it
///   colours     of all rows up to the last of them, sRGB
Bytes encode_colours(std::span<const std::array<std::uint8_t, 3>> colours, std::uint32_t first_row,
                     std::span<const std::uint32_t> map);

/// The other way round, from the colours of the rows before. Any bytes are colours. REQUIRES: colour_bytes() of them;
/// map[k] <= first_row + k; colours of first_row rows.
std::vector<std::array<std::uint8_t, 3>> decode_colours(ByteView raw,
                                                        std::span<const std::array<std::uint8_t, 3>> earlier,
                                                        std::span<const std::uint32_t> map);

}  // namespace eigencast
