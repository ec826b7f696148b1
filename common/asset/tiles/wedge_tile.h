// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/texture.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// A texture without its image. REQUIRES: valid.
Bytes encode_wedges(const AssetTexture& texture, const Asset& asset);

/// The other way round, without the image. Safe on hostile input. Errors: kCorrupt.
///   base_count, map, faces   of the finished asset
Result<AssetTexture> decode_wedges(ByteView raw, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                   const std::vector<Corners>& faces);

}  // namespace eigencast
