// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

#include "common/codec/key.h"

/// What key, chain and schemes share about the two ways in which a key holds its values.
namespace eigencast {

inline bool is_float(const CoefficientLayout& layout) {
  return layout.codec != CodecKind::kQuantised;
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
