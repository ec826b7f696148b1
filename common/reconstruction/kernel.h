// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>

namespace eigencast::kernel {

// Dense products of tall row-major matrices, in the widest vectors that this processor has (chosen when the program
// runs, so that a build for plain x86-64 is fast everywhere). Pointers need no alignment and must not overlap.

/// X = Psi C.
///   Psi  rows x rank, row-major, rows are `stride` floats apart
///   C    3 x rank, row-major (one row for each of x, y, z)
///   X    rows x 3, row-major
void product(const float* Psi, std::size_t rows, std::size_t stride, std::size_t rank, const float* C, float* X);

/// S += Psi^T Y, summed in float: meant for blocks of some tens of rows.
///   Psi  rows x rank, row-major
///   Y    rows x 3, row-major
///   S    3 x rank, row-major
void add_transposed_product(const float* Psi, std::size_t rows, std::size_t rank, const float* Y, float* S);

/// G += B^T B, its lower triangle in tiles of kGramTile: entries right of the diagonal tile are left as they are.
///   B  rows x width, row-major, width a multiple of kGramTile
///   G  width x width, row-major
inline constexpr std::size_t kGramTile = 8;
void add_gram(const double* B, std::size_t rows, std::size_t width, double* G);

}  // namespace eigencast::kernel
