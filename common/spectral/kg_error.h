// SPDX-License-Identifier: MIT
#pragma once

#include <cassert>
#include <cmath>
#include <limits>
#include <span>

#include "common/surface/vector.h"

namespace eigencast {

/// Karni & Gotsman 2004, "Compression of soft-body animation sequences": error in percent over a clip,
/// 100 ||X - Y||_F / ||X - mean(X)||_F, means per frame and axis. Takes frames one by one. Not thread-safe.
class KgError {
 public:
  /// REQUIRES: truth.size() == rebuilt.size()
  void add_frame(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
    assert(truth.size() == rebuilt.size());
    Vec3 mean{};
    for (const Vec3& vertex : truth) mean = mean + vertex;
    for (double& sum : mean) sum /= static_cast<double>(truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i) {
      numerator_ += squared_distance(truth[i], rebuilt[i]);
      denominator_ += squared_distance(truth[i], mean);
    }
  }
  /// Infinite where the truth is a single point and the rebuilt frame differs.
  double percent() const {
    if (denominator_ > 0) return 100 * std::sqrt(numerator_ / denominator_);
    return numerator_ > 0 ? std::numeric_limits<double>::infinity() : 0;
  }

 private:
  double numerator_ = 0, denominator_ = 0;
};

}  // namespace eigencast
