// SPDX-License-Identifier: MIT
#include "client/json_file.h"

#include <cmath>
#include <nlohmann/json.hpp>

namespace eigencast {

Result<std::vector<float>> numbers_from(const nlohmann::json& value, std::size_t count, const std::string& where) {
  if (!value.is_array() || value.size() != count)
    return fail(ErrorCode::kCorrupt, where + ": must be an array of " + std::to_string(count) + " numbers");
  std::vector<float> read;
  for (const nlohmann::json& number : value) {
    const double x = number.is_number() ? number.get<double>() : std::nan("");
    if (!std::isfinite(x) || std::abs(x) > 1e30)
      return fail(ErrorCode::kCorrupt, where + ": holds something that is not a finite number");
    read.push_back(static_cast<float>(x));
  }
  return read;
}

}  // namespace eigencast
