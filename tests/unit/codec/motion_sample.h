// SPDX-License-Identifier: MIT
#pragma once

#include <cmath>
#include <utility>
#include <vector>

#include "common/codec/chain.h"

namespace eigencast {

inline CoefficientLayout layout_of(CodecKind codec, std::uint32_t rows = 60, std::uint32_t channels = 3) {
  return {codec, rows, channels, default_band_ends(rows)};
}

/// A smooth motion of coefficients that fall off with the row, as those of a surface do.
class MotionSample {
 public:
  explicit MotionSample(CoefficientLayout layout) : layout_(std::move(layout)) {}

  std::vector<double> at(double time) const {
    std::vector<double> C(layout_.size());
    for (std::size_t i = 0; i < C.size(); ++i) {
      const auto row = static_cast<double>(i / layout_.channels);
      C[i] = 1000 / (1 + row) * std::sin(0.2 * time + static_cast<double>(i)) +
             3 * std::sin(1.7 * time * (1 + 0.01 * row));
    }
    return C;
  }
  Key key(double time, std::uint8_t step) const { return key_from_coefficients(layout_, at(time), step).value(); }
  /// The state after two keys.
  ChainState state(std::uint8_t step) const { return {key(0, step), key(1, step), 33'333}; }

 private:
  CoefficientLayout layout_;
};

}  // namespace eigencast
