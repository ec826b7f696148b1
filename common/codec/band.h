// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/result.h"

/// One band of quantised values as a head byte and Golomb-Rice bits (grammar: chain.cpp and docs/protocol.md).
namespace eigencast::band {

/// What a band may be predicted from: the values of the two latest keys in it, at the step of the frame. Empty where
/// absent.
struct References {
  std::vector<std::int32_t> c1;  ///< The latest key.
  std::vector<std::int32_t> c2;  ///< The one before it; never there without c1.
};

/// Appends the cheapest coding of `values` to `out`. REQUIRES: references are empty or of the same size; values within
/// range.
void append(std::span<const std::int32_t> values, const References& references, Bytes& out);

/// Reads values.size() values from the front of `in` and returns how many bytes they took. Safe on hostile input.
/// Errors: kCorrupt (predictor without its reference, bits missing, padding set, a value out of range).
Result<std::size_t> read(ByteView in, const References& references, std::span<std::int32_t> values);

}  // namespace eigencast::band
