// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>

#include "common/codec/key.h"

/// Helpers that key, chain and schemes share.
namespace eigencast {

inline bool is_float(const CoefficientLayout& layout) {
  return layout.codec != CodecKind::kQuantised;
}

inline Error overflow(std::size_t index) {
  return fail(ErrorCode::kTooLarge, "coefficient " + std::to_string(index) +
                                        " leaves the codec's range: use a larger step, or another codec");
}

/// A key whose values are all 0. `step` must be 0 with float codecs.
inline Key empty_key(const CoefficientLayout& layout, BandMask bands, std::uint8_t step) {
  Key key;
  key.bands = bands;
  key.step = step;
  if (is_float(layout)) {
    key.f.resize(layout.size());
  } else {
    key.q.resize(layout.size());
  }
  return key;
}

}  // namespace eigencast
