// SPDX-License-Identifier: MIT
//
// Each kernel is written once with the compiler's vector types and compiled twice: for AVX2 with fused multiply-add,
// and for what the build asks for (SSE2 on plain x86-64), where the compiler splits the vectors.
#include "common/reconstruction/kernel.h"

#include <cstring>

#if defined(__x86_64__)
#define EIGENCAST_HAS_AVX2_CLONE 1
#define EIGENCAST_AVX2 __attribute__((target("avx2,fma")))
#endif
#define EIGENCAST_INLINE inline __attribute__((always_inline))
// Running sums stay in registers only if the short loops over them are unrolled, which -O2 leaves undone.
#if defined(__clang__)
#define EIGENCAST_UNROLL _Pragma("unroll")
#else
#define EIGENCAST_UNROLL _Pragma("GCC unroll 8")
#endif

namespace eigencast::kernel {
namespace {

using Float8 = float __attribute__((vector_size(32)));
using Double4 = double __attribute__((vector_size(32)));
constexpr std::size_t kLanes = 8;
// The processor's own prefetching loses its way among several rows that are read side by side.
constexpr std::size_t kRowsAhead = 8;

// Loads write through a reference: a vector as a return value would change the calling convention between the two
// compilations.
EIGENCAST_INLINE void load(const float* from, Float8& to) {
  std::memcpy(&to, from, sizeof to);
}
EIGENCAST_INLINE void store(const Float8& from, float* to) {
  std::memcpy(to, &from, sizeof from);
}
EIGENCAST_INLINE void load(const double* from, Double4& to) {
  std::memcpy(&to, from, sizeof to);
}
EIGENCAST_INLINE void store(const Double4& from, double* to) {
  std::memcpy(to, &from, sizeof from);
}

EIGENCAST_INLINE float sum(const Float8& v) {
  return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}

// kRows rows at a time share the loads of C: 3 kRows running sums stay in registers.
template <std::size_t kRows>
EIGENCAST_INLINE void product_rows(const float* Psi, std::size_t stride, std::size_t rank, const float* C, float* X) {
  Float8 sums[kRows][3] = {};
  std::size_t k = 0;
  for (; k + kLanes <= rank; k += kLanes) {
    Float8 c[3];
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) load(C + d * rank + k, c[d]);
    EIGENCAST_UNROLL
    for (std::size_t i = 0; i < kRows; ++i) {
      Float8 row;
      load(Psi + i * stride + k, row);
      __builtin_prefetch(Psi + (i + kRowsAhead) * stride + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) sums[i][d] += row * c[d];
    }
  }
  EIGENCAST_UNROLL
  for (std::size_t i = 0; i < kRows; ++i) {
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) {
      float x = sum(sums[i][d]);
      for (std::size_t tail = k; tail < rank; ++tail) x += Psi[i * stride + tail] * C[d * rank + tail];
      X[3 * i + d] = x;
    }
  }
}

EIGENCAST_INLINE void product_all(const float* Psi, std::size_t rows, std::size_t stride, std::size_t rank,
                                  const float* C, float* X) {
  constexpr std::size_t kRows = 4;
  std::size_t i = 0;
  for (; i + kRows <= rows; i += kRows) product_rows<kRows>(Psi + i * stride, stride, rank, C, X + 3 * i);
  for (; i < rows; ++i) product_rows<1>(Psi + i * stride, stride, rank, C, X + 3 * i);
}

// kRows rows at a time share the loads and stores of S.
template <std::size_t kRows>
EIGENCAST_INLINE void add_transposed_rows(const float* Psi, std::size_t rank, const float* Y, float* S) {
  std::size_t k = 0;
  for (; k + kLanes <= rank; k += kLanes) {
    Float8 s[3];
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) load(S + d * rank + k, s[d]);
    EIGENCAST_UNROLL
    for (std::size_t i = 0; i < kRows; ++i) {
      Float8 row;
      load(Psi + i * rank + k, row);
      __builtin_prefetch(Psi + (i + kRowsAhead) * rank + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) s[d] += row * Y[3 * i + d];
    }
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) store(s[d], S + d * rank + k);
  }
  for (; k < rank; ++k) {
    EIGENCAST_UNROLL
    for (std::size_t i = 0; i < kRows; ++i) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) S[d * rank + k] += Psi[i * rank + k] * Y[3 * i + d];
    }
  }
}

EIGENCAST_INLINE void add_transposed_all(const float* Psi, std::size_t rows, std::size_t rank, const float* Y,
                                         float* S) {
  constexpr std::size_t kRows = 4;
  std::size_t i = 0;
  for (; i + kRows <= rows; i += kRows) add_transposed_rows<kRows>(Psi + i * rank, rank, Y + 3 * i, S);
  for (; i < rows; ++i) add_transposed_rows<1>(Psi + i * rank, rank, Y + 3 * i, S);
}

// One tile of 4 x 8 entries stays in registers while all rows pass.
EIGENCAST_INLINE void add_gram_tile(const double* B, std::size_t rows, std::size_t width, std::size_t i, std::size_t j,
                                    double* G) {
  Double4 sums[4][2];
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < 4; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < 2; ++b) load(G + (i + a) * width + j + 4 * b, sums[a][b]);
  }
  for (std::size_t row = 0; row < rows; ++row, B += width) {
    Double4 right[2];
    load(B + j, right[0]);
    load(B + j + 4, right[1]);
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < 4; ++a) {
      EIGENCAST_UNROLL
      for (std::size_t b = 0; b < 2; ++b) sums[a][b] += B[i + a] * right[b];
    }
  }
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < 4; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < 2; ++b) store(sums[a][b], G + (i + a) * width + j + 4 * b);
  }
}

EIGENCAST_INLINE void add_gram_all(const double* B, std::size_t rows, std::size_t width, double* G) {
  for (std::size_t i = 0; i < width; i += 4) {
    for (std::size_t j = 0; j <= i; j += kGramTile) add_gram_tile(B, rows, width, i, j, G);
  }
}

#ifdef EIGENCAST_HAS_AVX2_CLONE
EIGENCAST_AVX2 void product_avx2(const float* Psi, std::size_t rows, std::size_t stride, std::size_t rank,
                                 const float* C, float* X) {
  product_all(Psi, rows, stride, rank, C, X);
}
EIGENCAST_AVX2 void add_transposed_avx2(const float* Psi, std::size_t rows, std::size_t rank, const float* Y,
                                        float* S) {
  add_transposed_all(Psi, rows, rank, Y, S);
}
EIGENCAST_AVX2 void add_gram_avx2(const double* B, std::size_t rows, std::size_t width, double* G) {
  add_gram_all(B, rows, width, G);
}

bool has_avx2() {
  static const bool has = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return has;
}
#endif

}  // namespace

void product(const float* Psi, std::size_t rows, std::size_t stride, std::size_t rank, const float* C, float* X) {
#ifdef EIGENCAST_HAS_AVX2_CLONE
  if (has_avx2()) return product_avx2(Psi, rows, stride, rank, C, X);
#endif
  product_all(Psi, rows, stride, rank, C, X);
}

void add_transposed_product(const float* Psi, std::size_t rows, std::size_t rank, const float* Y, float* S) {
#ifdef EIGENCAST_HAS_AVX2_CLONE
  if (has_avx2()) return add_transposed_avx2(Psi, rows, rank, Y, S);
#endif
  add_transposed_all(Psi, rows, rank, Y, S);
}

void add_gram(const double* B, std::size_t rows, std::size_t width, double* G) {
#ifdef EIGENCAST_HAS_AVX2_CLONE
  if (has_avx2()) return add_gram_avx2(B, rows, width, G);
#endif
  add_gram_all(B, rows, width, G);
}

}  // namespace eigencast::kernel
