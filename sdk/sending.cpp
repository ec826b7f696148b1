// SPDX-License-Identifier: MIT
#include "sdk/sending.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/codec/band.h"
#include "sdk/send_policy.h"

namespace eigencast {
namespace {

std::optional<RateControl> rate_control_of(const PublisherOptions& options, const Asset* asset,
                                           const Quantiser& quantiser, const StreamFormat& format) {
  if (asset == nullptr || options.bitrate <= 0) return std::nullopt;
  return RateControl(options.bitrate, quantiser.half_spacing, static_cast<std::uint8_t>(format.band_ends.size()));
}

std::optional<MemoryKeeper::Options> keeper_options_of(const PublisherOptions& options, const Asset* asset,
                                                       const EncodedAsset& encoded, const CoefficientLayout& layout) {
  if (asset == nullptr || options.memory == MemoryUse::kOff || layout.is_float()) return std::nullopt;
  return MemoryKeeper::Options{layout, encoded.manifest.id.digest, options.bitrate, options.memory == MemoryUse::kOn};
}

/// Rounded up: rounded to nearest, keys may take some percent more bits than what `by` was chosen for.
std::uint8_t multiplied(std::uint8_t half_spacing, double by) {
  return static_cast<std::uint8_t>(std::clamp(std::ceil(half_spacing * by - 1e-9), 0.0, double{band::kMaxHalfSpacing}));
}

}  // namespace

Sending::Sending(const PublisherOptions& options, CodecKind codec, StreamFormat of,
                 std::shared_ptr<const Asset> surface, std::shared_ptr<const EncodedAsset> bytes, double coarser)
    : asset(std::move(surface)),
      encoded(std::move(bytes)),
      format(std::move(of)),
      quantiser(asset && codec == CodecKind::kQuantised
                    ? quantiser_for_error(error_bound(options, *asset), asset->area, asset->rank)
                    : Quantiser{}),
      projection(asset, options.velocities, format.scalars.size()),
      writer({codec, format.rows, format.channels, format.band_ends}, quantiser.half_spacing,
             rate_control_of(options, asset.get(), quantiser, format), multiplied(quantiser.half_spacing, coarser)),
      memory(writer.layout(), keeper_options_of(options, asset.get(), *encoded, writer.layout())) {}

std::vector<double> Ramp::carried_over(std::span<const double> C, std::size_t channels) const {
  return forth_ ? forth_->apply(C, channels) : std::vector<double>();
}

std::vector<double> Ramp::blended(std::span<const double> C, std::size_t channels) const {
  const double w = static_cast<double>(keys_ + 1) / kKeys;
  std::vector<double> mixed = forth_->apply(back_->apply(C, channels), channels);
  for (std::size_t i = 0; i < mixed.size(); ++i) mixed[i] += w * (C[i] - mixed[i]);
  return mixed;
}

}  // namespace eigencast
