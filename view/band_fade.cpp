// SPDX-License-Identifier: MIT
#include "view/band_fade.h"

#include <algorithm>

namespace eigencast {

void BandFade::apply(BandMask bands, TimeUs now_us, std::span<const std::uint32_t> band_ends,
                     std::span<const double> shown, Coefficients& wanted) {
  const BandMask changed = shown_bands_.value_or(bands) ^ bands;
  shown_bands_ = bands;
  if (!changed.empty()) {
    fading_ |= changed;
    started_us_ = now_us;
    from_.assign(shown.begin(), shown.end());
  }
  if (fading_.empty()) return;
  if (now_us - started_us_ >= kFadeUs || from_.size() != wanted.size() || band_ends.empty()) {
    fading_ = {};
    return;
  }
  const double share = static_cast<double>(std::max<TimeUs>(0, now_us - started_us_)) / kFadeUs;
  const std::size_t channels = wanted.size() / band_ends.back();
  std::vector<double>& values = wanted.edit();
  for (std::size_t band = 0; band < band_ends.size(); ++band) {
    if (!fading_.has(band)) continue;
    const auto [first, end] = band_range(band_ends, band, channels);
    for (std::size_t i = first; i < end; ++i) values[i] = from_[i] + share * (values[i] - from_[i]);
  }
}

void BandFade::reset() {
  *this = {};
}

}  // namespace eigencast
