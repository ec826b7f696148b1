// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/core/hash/sha256.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"

namespace eigencast {

/// What was baked before under `key`, whole and verified.
std::optional<BakeResult> load_bake(const AssetCache& cache, const Sha256& key);

Result<void> store_bake(const AssetCache& cache, const Sha256& key, const BakeResult& result);

}  // namespace eigencast
