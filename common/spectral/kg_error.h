// SPDX-License-Identifier: MIT
#pragma once

#include <span>

#include "common/surface/surface.h"

namespace eigencast {

/// Karni & Gotsman 2004, "Compression of soft-body animation sequences": error in percent over a clip,
/// 100 ||X - Y||_F / ||X - mean(X)||_F, means per frame and axis. Takes frames one by one. Not thread-safe.
class KgError {
 public:
  /// REQUIRES: truth.size() == rebuilt.size()
  void add_frame(std::span<const Vec3> truth, std::span<const Vec3> rebuilt);
  /// Infinite where the truth is a single point and the rebuilt frame differs.
  double percent() const;

 private:
  double numerator_ = 0;
  double denominator_ = 0;
};

}  // namespace eigencast
