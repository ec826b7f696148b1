// SPDX-License-Identifier: MIT
#include "tests/support/paths.h"

#include <cstdlib>

namespace eigencast {

std::filesystem::path data_dir() {
  const char* const folder = std::getenv("EIGENCAST_DATA_DIR");
  return folder != nullptr && *folder != '\0' ? folder : EIGENCAST_MADE_DATA_DIR;
}

bool has_data(const std::string& path) {
  return std::filesystem::exists(data_dir() / path);
}

std::filesystem::path gait_clip() {
  return data_dir() / "animations" / (has_data("animations/horse-gallop") ? "horse-gallop" : "animal-walk") /
         "vertices.npy";
}

std::filesystem::path rigged_file() {
  return data_dir() / "gltf" / (has_data("gltf/Fox.glb") ? "Fox.glb" : "animal.glb");
}

std::filesystem::path morphing_file() {
  return data_dir() / "gltf" / (has_data("gltf/AnimatedMorphCube.gltf") ? "AnimatedMorphCube.gltf" : "morphing.gltf");
}

std::string golden_dir() {
  return EIGENCAST_GOLDEN_DIR;
}

std::string bin_dir() {
  return EIGENCAST_BIN_DIR;
}

}  // namespace eigencast
