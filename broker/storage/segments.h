// SPDX-License-Identifier: MIT
#pragma once

#include <vector>

#include "broker/relay/generation.h"
#include "broker/storage/asset_store.h"

namespace eigencast::broker {

/// Reads the segments of a memory that are not here yet, by their ids. Blocks on the disk, throws nothing. Errors:
/// kNotFound, kTooLarge, kIo, kInternal, those of decode_segment. REQUIRES: ids are of 64 hexadecimal digits.
Result<void> load_segments(const AssetStore& assets, const CoefficientLayout& layout, const AssetDigest& asset,
                           std::vector<Generation::Segment>& segments);

}  // namespace eigencast::broker
