// SPDX-License-Identifier: MIT
#pragma once

#include <fstream>
#include <span>
#include <string>

#include "view/scene.h"

namespace eigencast {

/// Writes what was received, and what was shown, one JSON object a line (client/README.md has the fields).
///
/// Not thread-safe.
class PoseRecord final {
 public:
  /// Empty paths: nothing is written there. Errors: kIo.
  Result<void> open(const std::string& received, const std::string& shown);

  void received(std::size_t source, std::span<const ReceivedPose> poses);
  /// What the picture drawn at `drawn_us` shows.
  void shown(const Scene& scene, TimeUs drawn_us);

 private:
  std::ofstream received_, shown_;
};

}  // namespace eigencast
