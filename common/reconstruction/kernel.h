// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

#include "common/core/cpu.h"

namespace eigencast::kernel {

// Dense products with a basis that lies in tiles of kTileRows rows: within a tile column after column, so that vectors
// run along the rows, any number of leading columns is a prefix of the tile, and no sum crosses the lanes of a vector.

inline constexpr std::size_t kTileRows = 64;
inline constexpr std::size_t kAlignment = 64;     ///< Bytes that tiles begin at a multiple of.
inline constexpr std::size_t kWidestVector = 16;  ///< Floats in the widest vector of any variant.
inline constexpr std::size_t kGramTile = 8;

// Columns of integers lie in pairs, row by row: one word holds both. Of a word that is a float's bits, shifted or
// masked, either column comes kIntegerUnit-fold; and processors multiply and add both halves of words at once. The
// partner of a last odd column is zero.
inline constexpr double kIntegerUnit = 65536;
constexpr std::size_t whole_pairs(std::size_t columns) {
  return (columns + 1) / 2 * 2;
}
/// Where the integer of a tile's row and column lies.
constexpr std::size_t place_of_integer(std::size_t row, std::size_t column) {
  return column / 2 * 2 * kTileRows + 2 * row + column % 2;
}

/// Tiles one after the other: of each tile `float_columns` columns of floats and `integer_columns` columns of integers
/// are used; the next tile begins `float_stride`, `integer_stride` columns later. Both counts of integers are whole
/// pairs. Rows of the last tile that do not exist hold zero. An integer stands for kIntegerUnit times itself.
struct Tiles {
  const float* floats = nullptr;
  const std::int16_t* integers = nullptr;
  std::size_t float_columns = 0, float_stride = 0;
  std::size_t integer_columns = 0, integer_stride = 0;
};

/// Coefficients of one pose, and room for what they give.
///   C       columns x 3, floats' columns first
///   whole   of the integers' columns instead, pair after pair: for each axis the two of the pair side by side; no sum
///           of products with a row's integers may exceed 2^31 - 1. Null: C serves all columns.
///   unit    what a whole coefficient times an integer stands for, for each axis
///   X       rows x 3, row-major
struct Pose {
  const float* C = nullptr;
  const std::int16_t* whole = nullptr;
  float unit[3] = {};
  float* X = nullptr;
};

/// The kernels as one instruction set does them. Variants differ in rounding only: each result is within 1e-6 of the
/// sum of its terms' magnitudes.
struct Functions {
  /// X_p = Psi C_p for several poses in one pass over the basis.
  ///   rows  of the basis, from the first tile on
  void (*product)(const Tiles& tiles, std::size_t rows, const Pose* poses, std::size_t count);

  /// S += Psi^T Y. Within the call sums are in float, lane by lane: meant for some tens of tiles.
  ///   Y        tile after tile 3 x kTileRows; zero for rows that do not exist
  ///   S        columns x 3
  ///   scratch  columns x 3 x kWidestVector floats, aligned
  void (*add_transposed)(const Tiles& tiles, std::size_t tile_count, const float* Y, double* S, float* scratch);

  /// G += B^T B, its lower triangle in tiles of kGramTile: entries right of the diagonal tile are left as they are.
  ///   B  rows x width, row-major, width a multiple of kGramTile
  ///   G  width x width, row-major
  void (*add_gram)(const double* B, std::size_t rows, std::size_t width, double* G);

  /// C += T^T T S for a lower triangular T: what solving with the factor of a symmetric matrix gives, where T is its
  /// inverse.
  ///   T     rows x width, row-major, width a multiple of kGramTile; zero right of the diagonal
  ///   S, C  3 x width; S is zero beyond `rows`
  void (*add_inverse)(const double* T, std::size_t rows, std::size_t width, const double* S, double* C);
};

/// REQUIRES: `set` is one of instruction_sets(), or smaller than one.
const Functions& functions(InstructionSet set);
/// Those of the best instruction set here.
const Functions& functions();

}  // namespace eigencast::kernel
