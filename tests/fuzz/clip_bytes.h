// SPDX-License-Identifier: MIT
#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <string>

#include "common/surface/checks/check.h"
#include "common/surface/formats/clip.h"

namespace eigencast {

/// A file in memory that has a path, with a link whose ending names its format.
class MemoryFile {
 public:
  explicit MemoryFile(const std::string& ending) : descriptor_(memfd_create("fuzz", 0)) {
    std::string folder = "/tmp/eigencast-fuzz-XXXXXX";
    if (descriptor_ < 0 || mkdtemp(folder.data()) == nullptr) std::abort();
    path_ = folder + "/clip." + ending;
    const std::string target = "/proc/self/fd/" + std::to_string(descriptor_);
    if (symlink(target.c_str(), path_.c_str()) != 0) std::abort();
  }
  const std::string& holding(const std::uint8_t* data, std::size_t size) {
    if (ftruncate(descriptor_, 0) != 0 || pwrite(descriptor_, data, size, 0) != static_cast<ssize_t>(size))
      std::abort();
    return path_;
  }

 private:
  int descriptor_;
  std::string path_;
};

/// What is opened must keep its word: a valid rest pose, and poses of its size.
inline void check_clip(const Result<std::unique_ptr<MotionClip>>& clip) {
  if (!clip) return;
  const MotionClip& motion = **clip;
  if (!validate_surface(motion.rest()) || motion.frame_count() == 0) std::abort();
  for (const std::size_t frame : {std::size_t{0}, motion.frame_count() / 2, motion.frame_count() - 1}) {
    const auto pose = motion.pose(frame);
    if (pose && pose->size() != motion.rest().vertex_count()) std::abort();
  }
}

}  // namespace eigencast
