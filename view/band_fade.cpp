// SPDX-License-Identifier: MIT
#include "view/band_fade.h"

#include <algorithm>

namespace eigencast {

void BandFade::apply(std::uint8_t bands, TimeUs now_us, std::span<const std::uint32_t> band_ends,
                     std::span<const double> shown, std::span<double> wanted) {
  const auto changed = static_cast<std::uint8_t>(shown_bands_.value_or(bands) ^ bands);
  shown_bands_ = bands;
  if (changed != 0) {
    fading_ |= changed;
    started_us_ = now_us;
    from_.assign(shown.begin(), shown.end());
  }
  if (fading_ == 0) return;
  if (now_us - started_us_ >= kFadeUs || from_.size() != wanted.size() || band_ends.empty()) {
    fading_ = 0;
    return;
  }
  const double share = static_cast<double>(std::max<TimeUs>(0, now_us - started_us_)) / kFadeUs;
  const std::size_t channels = wanted.size() / band_ends.back();
  for (std::size_t band = 0; band < band_ends.size(); ++band) {
    if ((fading_ >> band & 1) == 0) continue;
    const std::size_t first = band == 0 ? 0 : band_ends[band - 1] * channels;
    for (std::size_t i = first; i < band_ends[band] * channels; ++i)
      wanted[i] = from_[i] + share * (wanted[i] - from_[i]);
  }
}

void BandFade::reset() {
  *this = {};
}

}  // namespace eigencast
