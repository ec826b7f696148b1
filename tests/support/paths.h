// SPDX-License-Identifier: MIT
// Where tests find files: what the build made, golden bytes, real data.
#pragma once

#include <filesystem>
#include <string>

namespace eigencast {

// Animations, meshes, gltf and clouds: the folder that the environment variable EIGENCAST_DATA_DIR names, real ones.
// Where it is unset, those that tests/support/make_data.py made.
std::filesystem::path data_dir();

// In data_dir(): the clip of an animal's gait (vertices.npy), a rigged file with the animations Walk and Run, one with
// two morph targets.
std::filesystem::path gait_clip();
std::filesystem::path rigged_file();
std::filesystem::path morphing_file();

// Whether data_dir() has this; for EIGENCAST_SKIP_WITHOUT.
bool has_data(const std::string& path);

// At the start of a test that holds figures of one real file.
#define EIGENCAST_SKIP_WITHOUT(path) \
  if (!::eigencast::has_data(path)) GTEST_SKIP() << "EIGENCAST_DATA_DIR has no " << (path)

// Golden bytes: tests/golden.
std::string golden_dir();

// The folder of the programs of this build.
std::string bin_dir();

}  // namespace eigencast
