// SPDX-License-Identifier: MIT
#include "common/core/files.h"

#include <cstdio>
#include <fstream>

namespace eigencast {

Result<void> write_file_atomically(const std::string& path, std::string_view content) {
  const std::string temporary = path + ".new";
  {
    std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
    file << content;
    file.close();
    if (!file) {
      std::remove(temporary.c_str());
      return fail(ErrorCode::kIo, path + ": cannot be written: check the folder, its permissions and the free space");
    }
  }
  if (std::rename(temporary.c_str(), path.c_str()) != 0) {
    std::remove(temporary.c_str());
    return fail(ErrorCode::kIo, path + ": cannot be put in place: is it a folder?");
  }
  return {};
}

}  // namespace eigencast
