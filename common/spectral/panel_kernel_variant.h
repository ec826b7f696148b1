// SPDX-License-Identifier: MIT
//
// The panels' kernels, once for each instruction set: a source file defines EIGENCAST_VARIANT, the name of its
// functions, and is compiled with that set's flags (common/core/vector_lanes.h).
#pragma once

#include "common/core/vector_lanes.h"
#include "common/spectral/panel_kernel.h"

namespace eigencast {
namespace {

constexpr std::size_t kVectors = kPanelWidth / kDoubleLanes;
constexpr std::size_t kGramRows = kDoubleLanes < 4 ? 2 : kDoubleLanes;  // kGramRows * kVectors sums fit the registers

// The processor's prefetcher stops at a page, and panels are read in short runs.
constexpr std::size_t kRowsAhead = 32;

struct Row {
  Doubles part[kVectors];
};

/// to += factor * x
inline void add(double factor, const Row& x, Row& to) {
  EIGENCAST_UNROLL
  for (std::size_t v = 0; v < kVectors; ++v) to.part[v] += factor * x.part[v];
}

void add_gram(const double* A, const double* B, std::size_t rows, double* G) {
  for (std::size_t first = 0; first < kPanelWidth; first += kGramRows) {
    Row sums[kGramRows];
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) sums[a] = load<Row>(G + (first + a) * kPanelWidth);
    for (std::size_t i = 0; i < rows; ++i) {
      const Row b = load<Row>(B + i * kPanelWidth);
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
    for (std::size_t a = 0; a < kGramRows; ++a) h[a] = load<Row>(H + (first + a) * kPanelWidth);
    for (std::size_t i = 0; i < rows; ++i) {
      Row w = load<Row>(W + i * kPanelWidth);
      __builtin_prefetch(A + (i + kRowsAhead) * kPanelWidth);
      EIGENCAST_UNROLL
      for (std::size_t a = 0; a < kGramRows; ++a) add(A[i * kPanelWidth + first + a], h[a], w);
      store(w, W + i * kPanelWidth);
    }
  }
}

void solve_lower(const UnitLower& L, std::size_t first, std::size_t end, double* X) {
  for (std::size_t j = first; j < end; ++j) {
    const Row x = load<Row>(X + j * kPanelWidth);
    for (int p = L.begin[j]; p < L.begin[j + 1]; ++p) {
      double* at = X + static_cast<std::size_t>(L.row[p]) * kPanelWidth;
      Row y = load<Row>(at);
      add(-L.value[p], x, y);
      store(y, at);
    }
  }
}

/// to += sum over p in [p, end) of kSign value[p] * row index[p] of X
template <int kSign>
inline void add_rows(const double* value, const int* index, int p, int end, const double* X, Row& to) {
  const auto row = [&](int q) { return load<Row>(X + static_cast<std::size_t>(index[q]) * kPanelWidth); };
  Row other = {};  // two sums, so that one addition need not wait for the other
  for (; p + 1 < end; p += 2) {
    add(kSign * value[p], row(p), to);
    add(kSign * value[p + 1], row(p + 1), other);
  }
  if (p < end) add(kSign * value[p], row(p), to);
  add(1, other, to);
}

void solve_upper(const UnitLower& L, std::size_t first, std::size_t end, double* X) {
  for (std::size_t j = end; j-- > first;) {
    Row x = load<Row>(X + j * kPanelWidth);
    add_rows<-1>(L.value, L.row, L.begin[j], L.begin[j + 1], X, x);
    store(x, X + j * kPanelWidth);
  }
}

void multiply(const SparseRows& S, std::size_t first, std::size_t end, const double* X, const double* shift,
              double* Y) {
  const Row by = load<Row>(shift);
  for (std::size_t i = first; i < end; ++i) {
    Row y = {};
    add_rows<1>(S.value, S.column, S.begin[i], S.begin[i + 1], X, y);
    const Row x = load<Row>(X + i * kPanelWidth);
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kVectors; ++v) y.part[v] -= by.part[v] * x.part[v];
    store(y, Y + i * kPanelWidth);
  }
}

}  // namespace

extern const PanelFunctions EIGENCAST_VARIANT;
const PanelFunctions EIGENCAST_VARIANT = {add_gram, add_product, solve_lower, solve_upper, multiply};

}  // namespace eigencast
