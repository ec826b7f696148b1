// SPDX-License-Identifier: MIT
#pragma once

#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "view/picture.h"

namespace eigencast::testing {

/// Errors: kIo, and those of read_png_bytes.
inline Result<Picture> read_png(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return fail(ErrorCode::kIo, path + ": cannot be opened");
  const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
  return read_png_bytes({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, path);
}

}  // namespace eigencast::testing
