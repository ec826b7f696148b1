// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/core/machine.h"

namespace eigencast::kernel {

// Dense products with a basis that lies in tiles of kTileRows rows: within a tile column after column, so that vectors
// run along the rows, any number of leading columns is a prefix of the tile, and no sum crosses the lanes of a vector.

inline constexpr std::size_t kTileRows = 64;
inline constexpr std::size_t kAlignment = 64;     ///< Bytes that tiles begin at a multiple of.
inline constexpr std::size_t kWidestVector = 16;  ///< Floats in the widest vector of any variant.
inline constexpr std::size_t kGramTile = 8;

// Columns of integers lie in pairs, row by row, two to a word. Shifted or masked, the word gives either column times
// kIntegerUnit; processors also multiply and add both halves at once. A last odd column is paired with zeros.
inline constexpr double kIntegerUnit = 65536;
constexpr std::size_t whole_pairs(std::size_t columns) {
  return (columns + 1) / 2 * 2;
}
/// The offset of a row's and column's integer in its tile.
constexpr std::size_t offset_of_integer(std::size_t row, std::size_t column) {
  return column / 2 * 2 * kTileRows + 2 * row + column % 2;
}

/// Consecutive tiles, of each the first `float_columns` and `integer_columns`; the next one begins `float_stride` and
/// `integer_stride` columns later. Both counts of integers are whole pairs. Missing rows of the last tile are zero.
struct Tiles {
  const float* floats = nullptr;
  const std::int16_t* integers = nullptr;
  std::size_t float_columns = 0, float_stride = 0;
  std::size_t integer_columns = 0, integer_stride = 0;
};

/// Coefficients of one pose, and room for its positions.
///   C       columns x 3, float columns first
///   whole   integer coefficients of the integer columns, pair after pair, the two of a pair side by side for each
///           axis; no sum of products with a row's integers may exceed 2^31 - 1. Null: use C for all columns
///   unit    of the product of two integers, for each axis
///   X       rows x 3, row-major
struct Pose {
  const float* C = nullptr;
  const std::int16_t* whole = nullptr;
  float unit[3] = {};
  float* X = nullptr;
};

/// The kernels of one instruction set. Variants differ in rounding only: each result is within 1e-6 of the sum of its
/// terms' magnitudes.
struct Functions {
  /// X_p = Psi C_p for several poses in one pass over the basis.
  ///   rows  of the basis, from the first tile on
  void (*product)(const Tiles& tiles, std::size_t rows, const Pose* poses, std::size_t count);

  /// S += Psi^T Y. Sums are in float, lane by lane: for some tens of tiles per call.
  ///   Y        3 x kTileRows for each tile; zero for missing rows
  ///   S        columns x 3
  ///   scratch  columns x 3 x kWidestVector floats, aligned
  void (*add_transposed)(const Tiles& tiles, std::size_t tile_count, const float* Y, double* S, float* scratch);

  /// G += B^T B, its lower triangle in tiles of kGramTile: entries right of the diagonal tile do not change.
  ///   B  rows x width, row-major, width a multiple of kGramTile
  ///   G  width x width, row-major
  void (*add_gram)(const double* B, std::size_t rows, std::size_t width, double* G);

  /// C += T^T T S for a lower triangular T: with the inverse of a Cholesky factor, a solve.
  ///   T     rows x width, row-major, width a multiple of kGramTile; zero right of the diagonal
  ///   S, C  3 x width; S is zero beyond `rows`
  void (*add_inverse)(const double* T, std::size_t rows, std::size_t width, const double* S, double* C);
};

/// REQUIRES: `set` is one of instruction_sets(), or smaller than one.
const Functions& functions(InstructionSet set);

}  // namespace eigencast::kernel
