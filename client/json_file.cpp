// SPDX-License-Identifier: MIT
#include "client/json_file.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

namespace eigencast {

Result<std::string> read_small_file(const std::string& path) {
  constexpr std::size_t kMost = 1 << 20;
  std::ifstream file(path, std::ios::binary);
  if (!file) return fail(ErrorCode::kIo, path + ": cannot be opened; is the path right?");
  std::string text(kMost + 1, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (file.bad() || file.gcount() == 0) return fail(ErrorCode::kIo, path + ": cannot be read, or is empty");
  text.resize(static_cast<std::size_t>(file.gcount()));
  if (text.size() > kMost) return fail(ErrorCode::kTooLarge, path + ": over 1 MiB, which no file of this kind needs");
  return text;
}

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
