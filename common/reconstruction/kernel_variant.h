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

inline Floats load(const std::int16_t* from) {
#if defined(__AVX512F__)
  __m256i narrow;
  std::memcpy(&narrow, from, sizeof narrow);
  return _mm512_maskz_cvtepi32_ps(0xffff, _mm512_maskz_cvtepi16_epi32(0xffff, narrow));
#elif defined(__AVX2__)
  __m128i narrow;
  std::memcpy(&narrow, from, sizeof narrow);
  return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(narrow));
#elif defined(__SSE2__)
  long long narrow;
  std::memcpy(&narrow, from, sizeof narrow);
  const __m128i twice = _mm_cvtsi64_si128(narrow);
  return _mm_cvtepi32_ps(_mm_srai_epi32(_mm_unpacklo_epi16(twice, twice), 16));
#elif defined(__ARM_NEON)
  return vcvtq_f32_s32(vmovl_s16(vld1_s16(from)));
#else
  return Floats{float(from[0]), float(from[1]), float(from[2]), float(from[3])};
#endif
}

// Rows that one pass over the columns of a tile takes, in vectors, so that its sums fit the registers.
template <std::size_t kPoses>
constexpr std::size_t vectors_per_pass() {
  constexpr std::size_t fitting = (kRegisters == 32 ? 8 : 4) / kPoses;
  constexpr std::size_t most = kTileRows / kLanes;
  return fitting < 1 ? 1 : fitting < most ? fitting : most;
}

template <std::size_t kPoses, std::size_t kVectors, typename Value>
inline void add_columns(const Value* column, std::size_t columns, std::size_t stride, const float* C,
                        std::size_t pose_stride, Floats (&sums)[kPoses][3][kVectors]) {
  constexpr std::size_t kLine = kAlignment / sizeof(Value);
  for (std::size_t k = 0; k < columns; ++k, column += kTileRows, C += 3) {
    // The next tile; where a pass takes a tile whole, the processor sees it coming.
    for (std::size_t i = 0; kVectors * kLanes < kTileRows && i < kVectors * kLanes; i += kLine) {
      __builtin_prefetch(column + stride * kTileRows + i, 0, 2);
    }
    Floats psi[kVectors];
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kVectors; ++v) psi[v] = load(column + v * kLanes);
    EIGENCAST_UNROLL
    for (std::size_t p = 0; p < kPoses; ++p) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        const float c = C[p * pose_stride + d];
        EIGENCAST_UNROLL
        for (std::size_t v = 0; v < kVectors; ++v) sums[p][d][v] += psi[v] * c;
      }
    }
  }
}

template <std::size_t kPoses>
inline void product_tile(const Tiles& tiles, std::size_t tile, std::size_t rows, const float* C,
                         std::size_t pose_stride, float* const* X) {
  constexpr std::size_t kVectors = vectors_per_pass<kPoses>();
  constexpr std::size_t kPassRows = kVectors * kLanes;
  for (std::size_t first = 0; first < rows; first += kPassRows) {
    Floats sums[kPoses][3][kVectors] = {};
    add_columns(tiles.floats + tile * tiles.float_stride * kTileRows + first, tiles.float_columns, tiles.float_stride,
                C, pose_stride, sums);
    add_columns(tiles.integers + tile * tiles.integer_stride * kTileRows + first, tiles.integer_columns,
                tiles.integer_stride, C + 3 * tiles.float_columns, pose_stride, sums);
    const std::size_t left = rows - first < kPassRows ? rows - first : kPassRows;
    for (std::size_t p = 0; p < kPoses; ++p) {
      float planes[3][kPassRows];
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        EIGENCAST_UNROLL
        for (std::size_t v = 0; v < kVectors; ++v) store(sums[p][d][v], planes[d] + v * kLanes);
      }
      float* out = X[p] + 3 * (tile * kTileRows + first);
      for (std::size_t i = 0; i < left; ++i, out += 3) {
        out[0] = planes[0][i];
        out[1] = planes[1][i];
        out[2] = planes[2][i];
      }
    }
  }
}

void product(const Tiles& tiles, std::size_t rows, const float* C, std::size_t poses, float* const* X) {
  constexpr std::size_t kTogether = 2;
  const std::size_t stride = 3 * (tiles.float_columns + tiles.integer_columns);
  for (std::size_t tile = 0; tile * kTileRows < rows; ++tile) {
    const std::size_t left = rows - tile * kTileRows;
    const std::size_t here = left < kTileRows ? left : kTileRows;
    // The tile stays in the cache while all poses pass.
    std::size_t p = 0;
    for (; p + kTogether <= poses; p += kTogether)
      product_tile<kTogether>(tiles, tile, here, C + p * stride, stride, X + p);
    for (; p < poses; ++p) product_tile<1>(tiles, tile, here, C + p * stride, stride, X + p);
  }
}

template <typename Value>
inline void add_transposed_columns(const Value* column, std::size_t columns, const float* Y, float* sums) {
  constexpr std::size_t kVectors = kTileRows / kLanes;
  for (std::size_t k = 0; k < columns; ++k, column += kTileRows, sums += 3 * kLanes) {
    Floats s[3] = {load(sums), load(sums + kLanes), load(sums + 2 * kLanes)};
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kVectors; ++v) {
      const Floats psi = load(column + v * kLanes);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) s[d] += psi * load(Y + d * kTileRows + v * kLanes);
    }
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) store(s[d], sums + d * kLanes);
  }
}

inline float sum_of_lanes(const float* lanes) {
  float half[kLanes / 2];
  for (std::size_t i = 0; i < kLanes / 2; ++i) half[i] = lanes[i] + lanes[i + kLanes / 2];
  EIGENCAST_UNROLL
  for (std::size_t width = kLanes / 4; width > 0; width /= 2) {
    for (std::size_t i = 0; i < width; ++i) half[i] += half[i + width];
  }
  return half[0];
}

void add_transposed(const Tiles& tiles, std::size_t tile_count, const float* Y, double* S, float* scratch) {
  const std::size_t count = 3 * (tiles.float_columns + tiles.integer_columns);
  for (std::size_t i = 0; i < count * kLanes; ++i) scratch[i] = 0;
  for (std::size_t tile = 0; tile < tile_count; ++tile, Y += 3 * kTileRows) {
    add_transposed_columns(tiles.floats + tile * tiles.float_stride * kTileRows, tiles.float_columns, Y, scratch);
    add_transposed_columns(tiles.integers + tile * tiles.integer_stride * kTileRows, tiles.integer_columns, Y,
                           scratch + 3 * kLanes * tiles.float_columns);
  }
  for (std::size_t i = 0; i < count; ++i) S[i] += static_cast<double>(sum_of_lanes(scratch + i * kLanes));
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

}  // namespace

extern const Functions EIGENCAST_VARIANT;
const Functions EIGENCAST_VARIANT = {product, add_transposed, add_gram};

}  // namespace eigencast::kernel
