// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdlib>

#include "common/codec/key.h"
#include "common/core/bytes.h"

namespace eigencast {

inline void require(bool condition) {
  if (!condition) std::abort();
}

inline CoefficientLayout layout_from(ByteReader& reader) {
  CoefficientLayout layout;
  layout.codec = static_cast<CodecKind>(reader.u8() % 3);
  layout.channels = 1u + reader.u8() % 4;
  const unsigned bands = 1u + reader.u8() % 4;
  for (unsigned band = 0; band < bands; ++band) {
    layout.rows += 1u + reader.u8() % 6;
    layout.band_ends.push_back(layout.rows);
  }
  return layout;
}

/// A key of arbitrary bands, step and values.
inline Key key_from(const CoefficientLayout& layout, ByteReader& reader) {
  Key key;
  key.bands = reader.u8() & layout.all_bands();
  if (key.bands.empty()) key.bands = 1;
  const bool quantised = layout.codec == CodecKind::kQuantised;
  key.step = quantised ? reader.u8() : std::uint8_t{0};
  (quantised ? key.q.resize(layout.size()) : key.f.resize(layout.size()));
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!key.bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i) {
      const unsigned shift = reader.u8() % 32;
      const auto value = std::clamp(static_cast<std::int32_t>(reader.u32()) >> shift, -(1 << 30), 1 << 30);
      if (quantised) {
        key.q[i] = value;
      } else {
        key.f[i] = static_cast<float>(value) * 0.25f;
      }
    }
  }
  return key;
}

}  // namespace eigencast
