// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <cstdio>
#include <filesystem>
#include <fstream>

namespace eigencast {
namespace {

bool write(const std::string& path, std::string_view content) {
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file << content;
  file.close();
  return !file.fail();
}

/// A device or a pipe: nothing may take its place.
bool is_special(const std::string& path) {
  std::error_code not_there;
  const auto type = std::filesystem::status(path, not_there).type();
  return type == std::filesystem::file_type::character || type == std::filesystem::file_type::block ||
         type == std::filesystem::file_type::fifo;
}

}  // namespace

Result<void> write_file_atomically(const std::string& path, std::string_view content) {
  const bool in_place = is_special(path);
  const std::string temporary = in_place ? path : path + ".new";
  if (!write(temporary, content)) {
    if (!in_place) std::remove(temporary.c_str());
    return fail(ErrorCode::kIo, path + ": cannot be written: check the folder, its permissions and the free space");
  }
  if (in_place) return {};
  if (std::rename(temporary.c_str(), path.c_str()) != 0) {
    std::remove(temporary.c_str());
    return fail(ErrorCode::kIo, path + ": cannot be put in place: is it a folder?");
  }
  return {};
}

}  // namespace eigencast
