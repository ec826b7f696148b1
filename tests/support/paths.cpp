// SPDX-License-Identifier: MIT
#include "tests/support/paths.h"

#include <cstdlib>

namespace eigencast {

std::filesystem::path data_dir() {
  const char* const folder = std::getenv("EIGENCAST_DATA_DIR");
  return folder != nullptr && *folder != '\0' ? folder : "/nonexistent/EIGENCAST_DATA_DIR-is-unset";
}

std::string golden_dir() { return EIGENCAST_GOLDEN_DIR; }

std::string bin_dir() { return EIGENCAST_BIN_DIR; }

}  // namespace eigencast
