// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/tiles/basis_block.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// The steps of the inexact columns: those given (one per column of the basis; empty: 0), but at least max |column| /
/// 32767; 0 for a column that is zero.
///   basis  n x r, row-major
std::vector<float> column_scales_from_basis(std::span<const float> basis, std::uint32_t rank,
                                            std::uint32_t exact_columns, std::span<const double> steps);

/// The basis as readers have it: n x r, row-major.
std::vector<float> on_grid(std::span<const float> basis, std::uint32_t rank, std::uint32_t exact_columns,
                           std::span<const float> column_scales);

/// basis: n x r, row-major, as the asset has it (not yet quantised).
Bytes encode_basis(const BasisBlock& block, std::span<const float> basis);

/// The same, coded (Compression::kCoded): in floats and integers of any distribution, about a tenth smaller than zstd
/// makes the other.
Bytes code_basis(const BasisBlock& block, std::span<const float> basis);

/// Writes rows first_row .. end_row and the block's columns into `basis` (at least end_row x r), whose earlier rows
/// must hold the same columns. Errors: kCorrupt (a number that is not finite or out of range). REQUIRES: raw.size() is
/// the block's size.
Result<void> decode_basis(const BasisBlock& block, ByteView raw, std::span<float> basis);
Result<void> decode_coded_basis(const BasisBlock& block, ByteView coded, std::span<float> basis);

/// What readers say of an entry that may not be.
Error entry_not_finite(std::uint32_t row, std::uint32_t column);
Error entry_out_of_range(std::uint32_t row, std::uint32_t column);

}  // namespace eigencast
