// SPDX-License-Identifier: MIT
//
// The panels' kernels, once for each instruction set: a source file defines EIGENCAST_VARIANT, the name of its functions,
// and is compiled with that set's flags. Nothing of the standard library may be called here: an inline function compiled
// with those flags could end up serving the whole program.
#pragma once

#include <cstring>

#include "common/spectral/panel_kernel.h"

#if defined(__clang__)
#define EIGENCAST_UNROLL _Pragma("unroll")
#else
#define EIGENCAST_UNROLL _Pragma("GCC unroll 16")
#endif

namespace eigencast {
namespace {

#if defined(__AVX512F__)
constexpr std::size_t kLanes = 8;
#elif defined(__AVX2__)
constexpr std::size_t kLanes = 4;
#else
constexpr std::size_t kLanes = 2;
#endif
constexpr std::size_t kVectors = kPanelWidth / kLanes;
constexpr std::size_t kGramRows = kLanes < 4 ? 2 : kLanes;  // so that kGramRows * kVectors sums fit the registers

// The processor's own prefetching does not look beyond a page, and panels are read in short runs.
constexpr std::size_t kRowsAhead = 32;

typedef double Lanes __attribute__((vector_size(kLanes * sizeof(double))));

struct Row {
  Lanes part[kVectors];
};

inline Row load(const double* from) {
  Row to;
  std::memcpy(&to, from, sizeof to);
  return to;
}
inline void store(const Row& from, double* to) {
  std::memcpy(to, &from, sizeof from);
}
/// to += factor * x
inline void add(double factor, const Row& x, Row& to) {
  EIGENCAST_UNROLL
  for (std::size_t v = 0; v < kVectors; ++v) to.part[v] += factor * x.part[v];
}

void add_gram(const double* A, const double* B, std::size_t rows, double* G) {
  for (std::size_t first = 0; first < kPanelWidth; first += kGramRows) {
    Row sums[kGramRows];
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) sums[a] = load(G + (first + a) * kPanelWidth);
    for (std::size_t i = 0; i < rows; ++i) {
      const Row b = load(B + i * kPanelWidth);
      __builtin_prefetch(A + (i + kRowsAhead) * kPanelWidth);
      EIGENCAST_UNROLL
      for (std::size_t a = 0; a < kGramRows; ++a) add(A[i * kPanelWidth + first + a], b, sums[a]);
    }
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) store(sums[a], G + (first + a) * kPanelWidth);
  }
}

void add_product(const double* A, const double* H, std::size_t rows, double* W) {
  for (std::size_t first = 0; first < kPanelWidth; first += kGramRows) {
    Row h[kGramRows];
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) h[a] = load(H + (first + a) * kPanelWidth);
    for (std::size_t i = 0; i < rows; ++i) {
      Row w = load(W + i * kPanelWidth);
      __builtin_prefetch(A + (i + kRowsAhead) * kPanelWidth);
      EIGENCAST_UNROLL
      for (std::size_t a = 0; a < kGramRows; ++a) add(A[i * kPanelWidth + first + a], h[a], w);
      store(w, W + i * kPanelWidth);
    }
  }
}

void solve_lower(const UnitLower& L, std::size_t first, std::size_t end, double* X) {
  for (std::size_t j = first; j < end; ++j) {
    const Row x = load(X + j * kPanelWidth);
    for (int p = L.begin[j]; p < L.begin[j + 1]; ++p) {
      double* at = X + static_cast<std::size_t>(L.row[p]) * kPanelWidth;
      Row y = load(at);
      add(-L.value[p], x, y);
      store(y, at);
    }
  }
}

void solve_upper(const UnitLower& L, std::size_t first, std::size_t end, double* X) {
  for (std::size_t j = end; j-- > first;) {
    Row x = load(X + j * kPanelWidth);
    Row other = {};  // two sums, so that one addition need not wait for the other
    int p = L.begin[j];
    for (; p + 1 < L.begin[j + 1]; p += 2) {
      add(-L.value[p], load(X + static_cast<std::size_t>(L.row[p]) * kPanelWidth), x);
      add(-L.value[p + 1], load(X + static_cast<std::size_t>(L.row[p + 1]) * kPanelWidth), other);
    }
    if (p < L.begin[j + 1]) add(-L.value[p], load(X + static_cast<std::size_t>(L.row[p]) * kPanelWidth), x);
    add(1, other, x);
    store(x, X + j * kPanelWidth);
  }
}

}  // namespace

extern const PanelFunctions EIGENCAST_VARIANT;
const PanelFunctions EIGENCAST_VARIANT = {add_gram, add_product, solve_lower, solve_upper};

}  // namespace eigencast
