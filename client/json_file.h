// SPDX-License-Identifier: MIT
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

/// A text file of at most 1 MiB, for the JSON that people write. Errors: kIo, kTooLarge.
Result<std::string> read_small_file(const std::string& path);

/// An array of `count` finite numbers of magnitude up to 1e30. Errors: kCorrupt, beginning with `where`.
Result<std::vector<float>> numbers_from(const nlohmann::json& value, std::size_t count, const std::string& where);

}  // namespace eigencast
