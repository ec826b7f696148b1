// SPDX-License-Identifier: MIT
// Where tests find files: what the build made, golden bytes, and real data where somebody has them.
#pragma once

#include <filesystem>
#include <string>

namespace eigencast {

// Real animations, meshes and clouds: the folder that the environment variable EIGENCAST_DATA_DIR names. Where it is unset, a path that does
// not exist, so that tests of real data find none and skip.
std::filesystem::path data_dir();

// Golden bytes: tests/golden.
std::string golden_dir();

// The folder of the programs of this build.
std::string bin_dir();

}  // namespace eigencast
