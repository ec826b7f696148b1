// SPDX-License-Identifier: MIT
//
// The kernels, once for each instruction set: a source file defines EIGENCAST_VARIANT, the name of its functions, and
// is compiled with that set's flags (common/core/vector_lanes.h).
#pragma once

#include <utility>

#include "common/core/vector_lanes.h"
#include "common/reconstruction/kernel.h"

namespace eigencast::kernel {
namespace {

static_assert(kFloatLanes <= kWidestVector);
constexpr std::size_t kVectors = kTileRows / kFloatLanes;  // in a column of a tile

// Vectors of a column in one pass over a tile, so that the sums fit the registers.
template <std::size_t kPoses>
constexpr std::size_t vectors_per_pass() {
  constexpr std::size_t fitting = (kVectorRegisters == 32 ? 8 : 4) / kPoses;
  return fitting < kVectors ? fitting : kVectors;
}
template <std::size_t kPoses>
constexpr std::size_t passes() {
  return kVectors / vectors_per_pass<kPoses>();
}

template <std::size_t kBytes>
inline void fetch(const void* at) {
  EIGENCAST_UNROLL
  for (std::size_t i = 0; i < kBytes; i += kAlignment) __builtin_prefetch(static_cast<const char*>(at) + i, 0, 2);
}

/// Prefetches every `turns`-th column, or pair, of the next tile, the first after `left` others, so that all passes
/// load memory evenly. A lone pass is bound by memory: it prefetches a little ahead and leaves the rest to the hardware
/// prefetcher, which keeps more requests in flight.
struct Prefetcher {
  std::size_t left, turns;
  bool lone;
  template <std::size_t kBytes, typename Value>
  void pass(const Value* at, std::size_t next_tile) {
    constexpr std::size_t kNear = 1024;  // bytes
    if (lone) return fetch<kBytes>(reinterpret_cast<const char*>(at) + kNear);
    if (left-- != 0) return;
    left = turns - 1;
    fetch<kBytes>(at + next_tile);
  }
};

/// Keeps vectors that several sums need in registers, where there are enough.
template <std::size_t kHere, typename Vector>
inline void hold_all(Vector (&vectors)[kHere]) {
  if constexpr (kVectorRegisters == 32) {
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kHere; ++v) hold(vectors[v]);
  }
}

/// Sums for each pose and axis.
template <typename Vector, std::size_t kPoses, std::size_t kHere>
struct Sums {
  Vector of[kPoses][3][kHere] = {};
};

template <std::size_t kPoses, std::size_t kHere>
inline void add_column(const Floats (&psi)[kHere], const Pose* poses, std::size_t column,
                       Sums<Floats, kPoses, kHere>& sums) {
  EIGENCAST_UNROLL
  for (std::size_t p = 0; p < kPoses; ++p) {
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) {
      const float c = poses[p].C[3 * column + d];
      EIGENCAST_UNROLL
      for (std::size_t v = 0; v < kHere; ++v) sums.of[p][d][v] += psi[v] * c;
    }
  }
}

template <std::size_t kPoses, std::size_t kHere>
inline void add_floats(const Tiles& tiles, const float* at, const Pose* poses, Prefetcher prefetcher,
                       Sums<Floats, kPoses, kHere>& sums) {
  for (std::size_t k = 0; k < tiles.float_columns; ++k, at += kTileRows) {
    prefetcher.pass<kTileRows * sizeof(float)>(at, tiles.float_stride * kTileRows);
    Floats psi[kHere];
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kHere; ++v) psi[v] = load<Floats>(at + v * kFloatLanes);
    hold_all(psi);
    add_column<kPoses, kHere>(psi, poses, k, sums);
  }
}

template <std::size_t kPoses, std::size_t kHere>
inline void add_integers(const Tiles& tiles, const std::int16_t* at, const Pose* poses, Prefetcher prefetcher,
                         Sums<Floats, kPoses, kHere>& sums) {
  for (std::size_t k = 0; k < tiles.integer_columns; k += 2, at += 2 * kTileRows) {
    prefetcher.pass<2 * kTileRows * sizeof(std::int16_t)>(at, tiles.integer_stride * kTileRows);
    Floats even[kHere], odd[kHere];
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kHere; ++v) {
      const Words both = load<Words>(at + 2 * v * kFloatLanes);
      even[v] = floats_of(both << 16);
      odd[v] = floats_of(both & ~0xffff);
    }
    hold_all(even);
    hold_all(odd);
    add_column<kPoses, kHere>(even, poses, tiles.float_columns + k, sums);
    add_column<kPoses, kHere>(odd, poses, tiles.float_columns + k + 1, sums);
  }
}

template <std::size_t kPoses, std::size_t kHere>
inline void add_wholes(const Tiles& tiles, const std::int16_t* at, const Pose* poses, Prefetcher prefetcher,
                       Sums<Floats, kPoses, kHere>& floats) {
  Sums<Words, kPoses, kHere> sums;
  for (std::size_t k = 0; k < tiles.integer_columns; k += 2, at += 2 * kTileRows) {
    prefetcher.pass<2 * kTileRows * sizeof(std::int16_t)>(at, tiles.integer_stride * kTileRows);
    Words both[kHere];
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kHere; ++v) both[v] = load<Words>(at + 2 * v * kFloatLanes);
    hold_all(both);
    EIGENCAST_UNROLL
    for (std::size_t p = 0; p < kPoses; ++p) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        const Words c = Words{} + load<std::int32_t>(poses[p].whole + 3 * k + 2 * d);
        EIGENCAST_UNROLL
        for (std::size_t v = 0; v < kHere; ++v) {
          sums.of[p][d][v] = add_products_of_halves(sums.of[p][d][v], both[v], c);
        }
      }
    }
  }
  EIGENCAST_UNROLL
  for (std::size_t p = 0; p < kPoses; ++p) {
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) {
      EIGENCAST_UNROLL
      for (std::size_t v = 0; v < kHere; ++v) floats.of[p][d][v] += floats_of(sums.of[p][d][v]) * poses[p].unit[d];
    }
  }
}

/// The kPart-th vector of 3 kFloatLanes interleaved floats, of which number i is axis i % 3 of row i / 3.
template <std::size_t kPart, std::size_t... kLane>
inline Floats interleaved(const Floats& x, const Floats& y, const Floats& z, std::index_sequence<kLane...>) {
  constexpr auto number = [](std::size_t lane) { return kPart * kFloatLanes + lane; };
  const Floats two = __builtin_shufflevector(x, y, ((number(kLane) % 3 == 1 ? kFloatLanes : 0) + number(kLane) / 3)...);
  return __builtin_shufflevector(two, z, (number(kLane) % 3 == 2 ? kFloatLanes + number(kLane) / 3 : kLane)...);
}

/// x, y, z of `rows` rows, one after the other.
inline void interleave(const float (&planes)[3][kTileRows], std::size_t rows, float* out) {
  constexpr std::make_index_sequence<kFloatLanes> kLanes;
  std::size_t i = 0;
  for (; i + kFloatLanes <= rows; i += kFloatLanes, out += 3 * kFloatLanes) {
    const auto x = load<Floats>(planes[0] + i), y = load<Floats>(planes[1] + i), z = load<Floats>(planes[2] + i);
    store(interleaved<0>(x, y, z, kLanes), out);
    store(interleaved<1>(x, y, z, kLanes), out + kFloatLanes);
    store(interleaved<2>(x, y, z, kLanes), out + 2 * kFloatLanes);
  }
  for (; i < rows; ++i, out += 3) {
    out[0] = planes[0][i];
    out[1] = planes[1][i];
    out[2] = planes[2][i];
  }
}

template <std::size_t kPoses, bool kWhole>
inline void product_tile(const Tiles& tiles, std::size_t tile, std::size_t rows, const Pose* poses, std::size_t turn,
                         std::size_t turns) {
  constexpr std::size_t kHere = vectors_per_pass<kPoses>();
  alignas(kAlignment) float planes[kPoses][3][kTileRows];
  const float* floats = tiles.floats + tile * tiles.float_stride * kTileRows;
  const std::int16_t* integers = tiles.integers + tile * tiles.integer_stride * kTileRows;
  for (std::size_t pass = 0; pass < passes<kPoses>(); ++pass) {
    const std::size_t row = pass * kHere * kFloatLanes;
    const Prefetcher prefetcher{turn + pass, turns, kPoses == 1 && turns == 1};
    Sums<Floats, kPoses, kHere> sums;
    if constexpr (kWhole) {
      add_wholes<kPoses, kHere>(tiles, integers + 2 * row, poses, prefetcher, sums);
    } else {
      add_integers<kPoses, kHere>(tiles, integers + 2 * row, poses, prefetcher, sums);
    }
    add_floats<kPoses, kHere>(tiles, floats + row, poses, prefetcher, sums);
    EIGENCAST_UNROLL
    for (std::size_t p = 0; p < kPoses; ++p) {
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) {
        EIGENCAST_UNROLL
        for (std::size_t v = 0; v < kHere; ++v) store(sums.of[p][d][v], planes[p][d] + row + v * kFloatLanes);
      }
    }
  }
  for (std::size_t p = 0; p < kPoses; ++p) interleave(planes[p], rows, poses[p].X + 3 * tile * kTileRows);
}

/// Poses per pass over a tile: two, if both have integer coefficients or neither has.
inline std::size_t poses_together(const Pose* poses, std::size_t left) {
  return left > 1 && (poses[0].whole != nullptr) == (poses[1].whole != nullptr) ? 2 : 1;
}

void product(const Tiles& tiles, std::size_t rows, const Pose* poses, std::size_t count) {
  std::size_t turns = 0;
  for (std::size_t p = 0; p < count;) {
    const std::size_t together = poses_together(poses + p, count - p);
    turns += together == 2 ? passes<2>() : passes<1>();
    p += together;
  }
  for (std::size_t tile = 0; tile * kTileRows < rows; ++tile) {
    const std::size_t left = rows - tile * kTileRows;
    const std::size_t here = left < kTileRows ? left : kTileRows;
    // The tile stays in the cache while all poses pass.
    std::size_t turn = 0;
    for (std::size_t p = 0; p < count;) {
      const Pose* at = poses + p;
      const std::size_t together = poses_together(at, count - p);
      if (together == 2) {
        (at->whole != nullptr ? product_tile<2, true> : product_tile<2, false>)(tiles, tile, here, at, turn, turns);
        turn += passes<2>();
      } else {
        (at->whole != nullptr ? product_tile<1, true> : product_tile<1, false>)(tiles, tile, here, at, turn, turns);
        turn += passes<1>();
      }
      p += together;
    }
  }
}

// Vectors of Y that registers hold beside two columns and their sums.
constexpr std::size_t kHeld = kVectorRegisters == 32 && kVectors > 4 ? 4 : kVectors;

struct HeldRows {
  Floats y[3][kHeld];
};

inline HeldRows load_rows(const float* Y, std::size_t first) {
  HeldRows rows;
  EIGENCAST_UNROLL
  for (std::size_t d = 0; d < 3; ++d) {
    EIGENCAST_UNROLL
    for (std::size_t v = 0; v < kHeld; ++v) rows.y[d][v] = load<Floats>(Y + d * kTileRows + (first + v) * kFloatLanes);
  }
  return rows;
}

// The next tile is prefetched: the writes of sums hide the pattern from the hardware prefetcher.

inline void add_transposed_floats(const float* tile, std::size_t columns, std::size_t stride, const float* Y,
                                  float* sums) {
  for (std::size_t first = 0; first < kVectors; first += kHeld) {
    const HeldRows rows = load_rows(Y, first);
    const float* at = tile;
    float* to = sums;
    for (std::size_t k = 0; k < columns; ++k, at += kTileRows, to += 3 * kFloatLanes) {
      if (first == 0) fetch<kTileRows * sizeof(float)>(at + stride * kTileRows);
      struct {
        Floats axis[3];
      } s = load<decltype(s)>(to);
      EIGENCAST_UNROLL
      for (std::size_t v = 0; v < kHeld; ++v) {
        const Floats psi = load<Floats>(at + (first + v) * kFloatLanes);
        EIGENCAST_UNROLL
        for (std::size_t d = 0; d < 3; ++d) s.axis[d] += psi * rows.y[d][v];
      }
      store(s, to);
    }
  }
}

inline void add_transposed_integers(const std::int16_t* tile, std::size_t columns, std::size_t stride, const float* Y,
                                    float* sums) {
  for (std::size_t first = 0; first < kVectors; first += kHeld) {
    const HeldRows rows = load_rows(Y, first);
    const std::int16_t* at = tile;
    float* to = sums;
    for (std::size_t k = 0; k < columns; k += 2, at += 2 * kTileRows, to += 6 * kFloatLanes) {
      if (first == 0) fetch<2 * kTileRows * sizeof(std::int16_t)>(at + stride * kTileRows);
      struct {
        Floats even[3], odd[3];
      } s = load<decltype(s)>(to);
      EIGENCAST_UNROLL
      for (std::size_t v = 0; v < kHeld; ++v) {
        const Words both = load<Words>(at + 2 * (first + v) * kFloatLanes);
        const Floats even = floats_of(both << 16), odd = floats_of(both & ~0xffff);
        EIGENCAST_UNROLL
        for (std::size_t d = 0; d < 3; ++d) s.even[d] += even * rows.y[d][v];
        EIGENCAST_UNROLL
        for (std::size_t d = 0; d < 3; ++d) s.odd[d] += odd * rows.y[d][v];
      }
      store(s, to);
    }
  }
}

void add_transposed(const Tiles& tiles, std::size_t tile_count, const float* Y, double* S, float* scratch) {
  const std::size_t count = 3 * (tiles.float_columns + tiles.integer_columns);
  for (std::size_t i = 0; i < count * kFloatLanes; ++i) scratch[i] = 0;
  for (std::size_t tile = 0; tile < tile_count; ++tile, Y += 3 * kTileRows) {
    add_transposed_floats(tiles.floats + tile * tiles.float_stride * kTileRows, tiles.float_columns, tiles.float_stride,
                          Y, scratch);
    add_transposed_integers(tiles.integers + tile * tiles.integer_stride * kTileRows, tiles.integer_columns,
                            tiles.integer_stride, Y, scratch + 3 * kFloatLanes * tiles.float_columns);
  }
  for (std::size_t i = 0; i < count; ++i)
    S[i] += static_cast<double>(sum_of_lanes(load<Floats>(scratch + i * kFloatLanes)));
}

constexpr std::size_t kGramRows = kVectorRegisters == 32 ? 8 : 4;
constexpr std::size_t kGramVectors = kGramTile / kDoubleLanes;

// One tile of entries stays in registers while all rows pass.
inline void add_gram_tile(const double* B, std::size_t rows, std::size_t width, std::size_t i, std::size_t j,
                          double* G) {
  Doubles sums[kGramRows][kGramVectors];
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < kGramRows; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b)
      sums[a][b] = load<Doubles>(G + (i + a) * width + j + kDoubleLanes * b);
  }
  for (std::size_t row = 0; row < rows; ++row, B += width) {
    Doubles right[kGramVectors];
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b) right[b] = load<Doubles>(B + j + kDoubleLanes * b);
    EIGENCAST_UNROLL
    for (std::size_t a = 0; a < kGramRows; ++a) {
      EIGENCAST_UNROLL
      for (std::size_t b = 0; b < kGramVectors; ++b) sums[a][b] += B[i + a] * right[b];
    }
  }
  EIGENCAST_UNROLL
  for (std::size_t a = 0; a < kGramRows; ++a) {
    EIGENCAST_UNROLL
    for (std::size_t b = 0; b < kGramVectors; ++b) store(sums[a][b], G + (i + a) * width + j + kDoubleLanes * b);
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
    for (std::size_t k = 0; k < end; k += kDoubleLanes) {
      __builtin_prefetch(T + width + k);
      const Doubles t = load<Doubles>(T + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) sums[d] += t * load<Doubles>(S + d * width + k);
    }
    double y[3];
    EIGENCAST_UNROLL
    for (std::size_t d = 0; d < 3; ++d) y[d] = sum_of_lanes(sums[d]);
    for (std::size_t k = 0; k < end; k += kDoubleLanes) {
      const Doubles t = load<Doubles>(T + k);
      EIGENCAST_UNROLL
      for (std::size_t d = 0; d < 3; ++d) store(load<Doubles>(C + d * width + k) + t * y[d], C + d * width + k);
    }
  }
}

}  // namespace

extern const Functions EIGENCAST_VARIANT;
const Functions EIGENCAST_VARIANT = {product, add_transposed, add_gram, add_inverse};

}  // namespace eigencast::kernel
