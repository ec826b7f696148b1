// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/bands.h"
#include "common/core/clock.h"
#include "common/motion/coefficients.h"

namespace eigencast {

/// When the set of received bands changes (docs/protocol.md, section 6) the affected bands go from the values shown to
/// the new ones within kFadeUs of display time. Not thread-safe.
class BandFade {
 public:
  static constexpr TimeUs kFadeUs = 150'000;

  /// Blends `wanted`, a pose of these bands, with the pose `shown` when they changed, both band_ends.back() x channels,
  /// row-major. Nothing fades if they differ in size or band_ends is empty.
  void apply(BandMask bands, TimeUs now_us, std::span<const std::uint32_t> band_ends, std::span<const double> shown,
             Coefficients& wanted);

  bool fading() const { return !fading_.empty(); }

  void reset();

 private:
  std::optional<BandMask> shown_bands_;
  BandMask fading_;
  TimeUs started_us_ = 0;
  std::vector<double> from_;  ///< Shown at started_us_.
};

}  // namespace eigencast
