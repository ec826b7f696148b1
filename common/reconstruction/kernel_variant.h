// SPDX-License-Identifier: MIT
//
// The kernels, once for each instruction set: a source file defines EIGENCAST_VARIANT, the name of its functions, and is
// compiled with that set's flags. Nothing of the standard library may be called here: an inline function compiled with
// those flags could end up serving the whole program.
#pragma once

#include <cstring>

#include "common/reconstruction/kernel.h"

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#endif

// Running sums stay in registers only if the short loops over them are unrolled.
#if defined(__clang__)
#define EIGENCAST_UNROLL _Pragma("unroll")
#else
#define EIGENCAST_UNROLL _Pragma("GCC unroll 16")
#endif

namespace eigencast::kernel {
namespace {

#if defined(__AVX512F__)
constexpr std::size_t kLanes = 16;
constexpr std::size_t kRegisters = 32;
#elif defined(__AVX2__)
constexpr std::size_t kLanes = 8;
constexpr std::size_t kRegisters = 16;
#elif defined(__ARM_NEON)
constexpr std::size_t kLanes = 4;
constexpr std::size_t kRegisters = 32;
#else
constexpr std::size_t kLanes = 4;
constexpr std::size_t kRegisters = 16;
#endif
static_assert(kLanes <= kWidestVector);

typedef float Floats __attribute__((vector_size(kLanes * sizeof(float))));
typedef double Doubles __attribute__((vector_size(kLanes * sizeof(float))));
constexpr std::size_t kDoubles = kLanes / 2;

inline Floats load(const float* from) {
  Floats to;
  std::memcpy(&to, from, sizeof to);
  return to;
}
inline void store(const Floats& from, float* to) {
  std::memcpy(to, &from, sizeof from);
}
inline Doubles load(const double* from) {
  Doubles to;
  std::memcpy(&to, from, sizeof to);
  return to;
}
inline void store(const Doubles& from, double* to) {
  std::memcpy(to, &from, sizeof from);
}

typedef std::int32_t Integers __attribute__((vector_size(kLanes * sizeof(std::int32_t))));

inline Floats floats_of(const Integers& from) {
#if defined(__AVX512F__)
  return _mm512_maskz_cvtepi32_ps(0xffff, reinterpret_cast<__m512i>(from));
#else
  return __builtin_convertvector(from, Floats);
#endif
}

constexpr std::size_t kPairsInGroup = kGroupRows / kLanes;
constexpr std::size_t kPairs = kTileRows / (2 * kLanes);

/// The row of the first vector of a tile's pair of vectors; the other begins kGroupRows later.
constexpr std::size_t row_of_pair(std::size_t pair) {
  return pair / kPairsInGroup * 2 * kGroupRows + pair % kPairsInGroup * kLanes;
}

/// Two vectors of a column's entries.
inline void load_pair(const float* column, std::size_t pair, Floats& first, Floats& second) {
  first = load(column + row_of_pair(pair));
  second = load(column + row_of_pair(pair) + kGroupRows);
}
/// The same of integers, kIntegerUnit-fold: what the sign takes to extend is left out.
inline void load_pair(const std::int16_t* column, std::size_t pair, Floats& first, Floats& second) {
  Integers both;
  std::memcpy(&both, column + pair * 2 * kLanes, sizeof both);
  first = floats_of(both << 16);
  second = floats_of(both & ~0xffff);
}

// Pairs of vectors that one pass over the columns of a tile takes, so that its sums fit the registers.
template <std::size_t kPoses>
constexpr std::size_t pairs_per_pass() {
  constexpr std::size_t fitting = (kRegisters == 32 ? 4 : 2) / kPoses;
  return fitting < 1 ? 1 : fitting < kPairs ? fitting : kPairs;
}

template <std::size_t kPoses, std::size_t kHere, typename Value>
inline void add_columns(const Value* column, std::size_t first_pair, std::size_t columns, std::size_t stride,
                        const float* C, std::size_t pose_stride, bool ahead, Floats (&sums)[kPoses][3][2 * kHere]) {
  constexpr std::size_t kLine = kAlignment / sizeof(Value);
  for (std::size_t k = 0; k < columns; ++k, column += kTileRows, C += 3) {
    if (ahead) {
      EIGENCAST_UNROLL
      for (std::size_t i = 0; i < kTileRows; i += kLine) __builtin_prefetch(column + stride * kTileRows + i, 0, 2);
    }
    Floats psi[2 * kHere];
    EIGENCAST_UNROLL
    for (std::size_t q = 0; q < kHere; ++q) load_pair(column, first_pair + q, psi[2 * q], psi[2 * q + 1]);
    EIGENCAST_UNROLL
    for (std::size_t p = 0; p < kPoses; ++p) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        const float c = C[p * pose_stride + d];
        EIGENCAST_UNROLL
        for (std::size_t v = 0; v < 2 * kHere; ++v) sums[p][d][v] += psi[v] * c;
      }
    }
  }
}

/// x, y, z of `rows` rows, one after the other.
inline void interleave(const float (&planes)[3][kTileRows], std::size_t rows, float* out) {
  typedef float Four __attribute__((vector_size(16)));
  std::size_t i = 0;
  for (; i + 4 <= rows; i += 4, out += 12) {
    Four x, y, z;
    std::memcpy(&x, planes[0] + i, sizeof x);
    std::memcpy(&y, planes[1] + i, sizeof y);
    std::memcpy(&z, planes[2] + i, sizeof z);
    const Four low = __builtin_shufflevector(x, y, 0, 4, 1, 5);
    const Four high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
    const Four middle = __builtin_shufflevector(low, z, 3, 5, 3, 5);
    const Four rows_of_four[3] = {__builtin_shufflevector(low, z, 0, 1, 4, 2),
                                  __builtin_shufflevector(middle, high, 0, 1, 4, 5),
                                  __builtin_shufflevector(z, high, 2, 6, 7, 3)};
    std::memcpy(out, rows_of_four, sizeof rows_of_four);
  }
  for (; i < rows; ++i, out += 3) {
    out[0] = planes[0][i];
    out[1] = planes[1][i];
    out[2] = planes[2][i];
  }
}

template <std::size_t kPoses>
inline void product_tile(const Tiles& tiles, std::size_t tile, std::size_t rows, const float* C,
                         std::size_t pose_stride, bool ahead, float* const* X) {
  constexpr std::size_t kHere = pairs_per_pass<kPoses>();
  alignas(kAlignment) float planes[kPoses][3][kTileRows];
  for (std::size_t pair = 0; pair < kPairs; pair += kHere) {
    Floats sums[kPoses][3][2 * kHere] = {};
    const bool last = ahead && pair + kHere == kPairs;
    add_columns<kPoses, kHere>(tiles.floats + tile * tiles.float_stride * kTileRows, pair, tiles.float_columns,
                               tiles.float_stride, C, pose_stride, last, sums);
    add_columns<kPoses, kHere>(tiles.integers + tile * tiles.integer_stride * kTileRows, pair, tiles.integer_columns,
                               tiles.integer_stride, C + 3 * tiles.float_columns, pose_stride, last, sums);
    EIGENCAST_UNROLL
    for (std::size_t p = 0; p < kPoses; ++p) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        EIGENCAST_UNROLL
        for (std::size_t q = 0; q < kHere; ++q) {
          store(sums[p][d][2 * q], planes[p][d] + row_of_pair(pair + q));
          store(sums[p][d][2 * q + 1], planes[p][d] + row_of_pair(pair + q) + kGroupRows);
        }
      }
    }
  }
  for (std::size_t p = 0; p < kPoses; ++p) interleave(planes[p], rows, X[p] + 3 * tile * kTileRows);
}

void product(const Tiles& tiles, std::size_t rows, const float* C, std::size_t poses, float* const* X) {
  constexpr std::size_t kTogether = 2;
  const std::size_t stride = 3 * (tiles.float_columns + tiles.integer_columns);
  for (std::size_t tile = 0; tile * kTileRows < rows; ++tile) {
    const std::size_t left = rows - tile * kTileRows;
    const std::size_t here = left < kTileRows ? left : kTileRows;
    // The tile stays in the cache while all poses pass, and the last one asks for the next tile; where one pass is all,
    // the processor sees the next one coming.
    std::size_t p = 0;
    for (; p + kTogether <= poses; p += kTogether) {
      const bool ahead = p + kTogether == poses && (p > 0 || pairs_per_pass<kTogether>() < kPairs);
      product_tile<kTogether>(tiles, tile, here, C + p * stride, stride, ahead, X + p);
    }
    if (p < poses) {
      const bool ahead = p > 0 || pairs_per_pass<1>() < kPairs;
      product_tile<1>(tiles, tile, here, C + p * stride, stride, ahead, X + p);
    }
  }
}

// Y of as many pairs as registers hold beside a column and its sums.
constexpr std::size_t kHeldPairs = kRegisters == 32 && kPairs > 2 ? 2 : kPairs;

template <typename Value>
inline void add_transposed_columns(const Value* column, std::size_t columns, std::size_t stride, const float* Y,
                                   float* sums) {
  constexpr std::size_t kLine = kAlignment / sizeof(Value);
  for (std::size_t pair = 0; pair < kPairs; pair += kHeldPairs) {
    Floats y[3][2 * kHeldPairs];
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) {
      EIGENCAST_UNROLL
      for (std::size_t q = 0; q < kHeldPairs; ++q) load_pair(Y + d * kTileRows, pair + q, y[d][2 * q], y[d][2 * q + 1]);
    }
    const Value* at = column;
    float* to = sums;
    for (std::size_t k = 0; k < columns; ++k, at += kTileRows, to += 3 * kLanes) {
      if (pair == 0) {  // The sums push what the processor fetches ahead out of its view.
        EIGENCAST_UNROLL
        for (std::size_t i = 0; i < kTileRows; i += kLine) __builtin_prefetch(at + stride * kTileRows + i, 0, 2);
      }
      Floats s[3] = {load(to), load(to + kLanes), load(to + 2 * kLanes)};
      EIGENCAST_UNROLL
      for (std::size_t q = 0; q < kHeldPairs; ++q) {
        Floats first, second;
        load_pair(at, pair + q, first, second);
        EIGENCAST_UNROLL
        for (std::size_t d = 0; d < 3; ++d) s[d] += first * y[d][2 * q];
        EIGENCAST_UNROLL
        for (std::size_t d = 0; d < 3; ++d) s[d] += second * y[d][2 * q + 1];
      }
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) store(s[d], to + d * kLanes);
    }
  }
}

template <typename Lanes>
inline auto sum_of_lanes(Lanes lanes) {
  EIGENCAST_UNROLL
  for (std::size_t width = sizeof(Lanes) / sizeof(lanes[0]) / 2; width > 0; width /= 2) {
    EIGENCAST_UNROLL
    for (std::size_t i = 0; i < width; ++i) lanes[i] += lanes[i + width];
  }
  return lanes[0];
}

void add_transposed(const Tiles& tiles, std::size_t tile_count, const float* Y, double* S, float* scratch) {
  const std::size_t count = 3 * (tiles.float_columns + tiles.integer_columns);
  for (std::size_t i = 0; i < count * kLanes; ++i) scratch[i] = 0;
  for (std::size_t tile = 0; tile < tile_count; ++tile, Y += 3 * kTileRows) {
    add_transposed_columns(tiles.floats + tile * tiles.float_stride * kTileRows, tiles.float_columns,
                           tiles.float_stride, Y, scratch);
    add_transposed_columns(tiles.integers + tile * tiles.integer_stride * kTileRows, tiles.integer_columns,
                           tiles.integer_stride, Y, scratch + 3 * kLanes * tiles.float_columns);
  }
  for (std::size_t i = 0; i < count; ++i) S[i] += static_cast<double>(sum_of_lanes(load(scratch + i * kLanes)));
}

constexpr std::size_t kGramRows = kRegisters == 32 ? 8 : 4;
constexpr std::size_t kGramVectors = kGramTile / kDoubles;

// One tile of entries stays in registers while all rows pass.
inline void add_gram_tile(const double* B, std::size_t rows, std::size_t width, std::size_t i, std::size_t j,
                          double* G) {
  Doubles sums[kGramRows][kGramVectors];
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < kGramRows; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b) sums[a][b] = load(G + (i + a) * width + j + kDoubles * b);
  }
  for (std::size_t row = 0; row < rows; ++row, B += width) {
    Doubles right[kGramVectors];
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b) right[b] = load(B + j + kDoubles * b);
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) {
      EIGENCAST_UNROLL
      for (std::size_t b = 0; b < kGramVectors; ++b) sums[a][b] += B[i + a] * right[b];
    }
  }
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < kGramRows; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b) store(sums[a][b], G + (i + a) * width + j + kDoubles * b);
  }
}

void add_gram(const double* B, std::size_t rows, std::size_t width, double* G) {
  for (std::size_t i = 0; i < width; i += kGramRows) {
    for (std::size_t j = 0; j <= i; j += kGramTile) add_gram_tile(B, rows, width, i, j, G);
  }
}

// A row of T is used twice while it is at hand: for its entry of T S, and for what that adds to C.
void add_inverse(const double* T, std::size_t rows, std::size_t width, const double* S, double* C) {
  for (std::size_t i = 0; i < rows; ++i, T += width) {
    const std::size_t end = (i / kGramTile + 1) * kGramTile;
    Doubles sums[3] = {};
    for (std::size_t k = 0; k < end; k += kDoubles) {
      __builtin_prefetch(T + width + k);
      const Doubles t = load(T + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) sums[d] += t * load(S + d * width + k);
    }
    double y[3];
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) y[d] = sum_of_lanes(sums[d]);
    for (std::size_t k = 0; k < end; k += kDoubles) {
      const Doubles t = load(T + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) store(load(C + d * width + k) + t * y[d], C + d * width + k);
    }
  }
}

}  // namespace

extern const Functions EIGENCAST_VARIANT;
const Functions EIGENCAST_VARIANT = {product, add_transposed, add_gram, add_inverse};

}  // namespace eigencast::kernel
