// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

inline constexpr std::uint64_t kMaxJsonFileBytes = 1 << 20;

/// An array of `count` finite numbers of magnitude up to 1e30. Errors: kCorrupt, beginning with `where`.
Result<std::vector<float>> numbers_from(const nlohmann::json& value, std::size_t count, const std::string& where);

}  // namespace eigencast
