// SPDX-License-Identifier: MIT
#pragma once

#include "common/asset/format/reader.h"
#include "web/core/core.h"

struct core_asset {
  eigencast::AssetReader reader;
  std::uint64_t number;  ///< Tells it from others that had its address, and from itself before it was widened.
  core_chunk chunk{};
  core_facts facts{};
  core_basis basis{};
};
