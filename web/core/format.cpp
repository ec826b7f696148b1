// SPDX-License-Identifier: MIT
#include "web/core/format.h"

#include "common/codec/key.h"
#include "common/wire/sizes.h"

namespace eigencast::web {

Result<StreamFormat> format_from(const core_format& given) {
  if (given.scalars > CORE_MAX_CHANNELS || given.codec >= kCodecNames.names.size() ||
      given.scheme >= kSchemeNames.names.size() || given.bands > CORE_MAX_BANDS) {
    return fail(ErrorCode::kInvalidArgument,
                "there is no such codec or scheme, or there are too many bands or scalars");
  }
  StreamFormat format;
  format.rows = given.rows;
  format.channels = given.channels;
  format.band_ends.assign(given.band_ends, given.band_ends + given.bands);
  format.codec = kCodecNames.names[given.codec];
  format.velocity_channels = given.velocity_channels;
  format.velocity_us = given.velocity_us;
  format.scalars.resize(given.scalars);
  for (std::uint32_t k = 0; k < given.scalars; ++k) format.scalars[k].scale = given.scales[k];
  if (const auto good = check_sizes(format); !good) return good.error();
  return format;
}

}  // namespace eigencast::web
