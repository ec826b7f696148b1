// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/core/hash/sha256.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"

namespace eigencast {

/// What was baked before from what `key` is the hash of, whole and verified; nothing where a part is missing or
/// damaged.
std::optional<BakeResult> load_bake(const AssetCache& cache, const Sha256& key);

/// Keeps the result for load_bake(). Errors: those of the cache.
Result<void> store_bake(const AssetCache& cache, const Sha256& key, const BakeResult& result);

}  // namespace eigencast
