// SPDX-License-Identifier: MIT
#pragma once

#include <fstream>
#include <span>
#include <string>

#include "view/scene.h"

namespace eigencast {

/// Writes received and shown poses, one JSON object a line (client/README.md has the fields). Not thread-safe.
class PoseRecord final {
 public:
  /// Paths may be empty. Errors: kIo.
  Result<void> open(const std::string& received, const std::string& shown);

  void received(std::size_t source, std::span<const ReceivedPose> poses);
  void shown(const Scene& scene, TimeUs drawn_us);

 private:
  std::ofstream received_, shown_;
};

}  // namespace eigencast
