// SPDX-License-Identifier: MIT
#pragma once

#include <span>

#include "common/surface/surface.h"

namespace eigencast {

/// Karni & Gotsman 2004, "Compression of soft-body animation sequences": error in percent over a clip,
/// 100 ||X - Y||_F / ||X - mean(X)||_F, means per frame and axis. Frames come one by one, so that a clip need not be in
/// memory. Not thread-safe.
class KgError {
 public:
  /// REQUIRES: truth.size() == rebuilt.size()
  void add_frame(std::span<const Vec3> truth, std::span<const Vec3> rebuilt);
  /// Infinite where the truth stands on a point and something else was rebuilt.
  double percent() const;

 private:
  double numerator_ = 0;
  double denominator_ = 0;
};

}  // namespace eigencast
