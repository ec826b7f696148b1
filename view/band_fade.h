// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Fades between two readings of the coefficients when the set of bands that come has changed (docs/protocol.md,
/// section 6): the bands concerned go from what was shown to what is to be shown within kFadeUs of display time, so
/// that detail does not snap in or out.
///
/// Time comes in as arguments. Not thread-safe.
class BandFade {
 public:
  static constexpr TimeUs kFadeUs = 150'000;

  /// Makes `wanted`, the pose to show, made of the bands of the mask, what is to be shown at `now_us`. `shown` is what
  /// was shown last; both are band_ends.back() x channels, row-major. Nothing is faded if they differ in size (other
  /// channels than before) or band_ends is empty (unknown).
  void apply(std::uint8_t bands, TimeUs now_us, std::span<const std::uint32_t> band_ends, std::span<const double> shown,
             std::span<double> wanted);

  /// True while the same pose looks different from one display time to the next.
  bool fading() const { return fading_ != 0; }

  /// Forgets everything, as at a new asset.
  void reset();

 private:
  std::optional<std::uint8_t> shown_bands_;
  std::uint8_t fading_ = 0;   ///< Mask of the bands on their way.
  TimeUs started_us_ = 0;     ///< Display time.
  std::vector<double> from_;  ///< What was shown then.
};

}  // namespace eigencast
