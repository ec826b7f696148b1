// SPDX-License-Identifier: MIT
#include "common/spectral/kg_error.h"

#include <cassert>
#include <cmath>
#include <cstddef>
#include <limits>

#include "common/surface/checks/surface_distance.h"

namespace eigencast {

void KgError::add_frame(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  assert(truth.size() == rebuilt.size());
  Vec3 mean{};
  for (const Vec3& vertex : truth) {
    for (std::size_t axis = 0; axis < 3; ++axis) mean[axis] += vertex[axis];
  }
  for (double& sum : mean) sum /= static_cast<double>(truth.size());
  for (std::size_t i = 0; i < truth.size(); ++i) {
    numerator_ += squared_distance(truth[i], rebuilt[i]);
    denominator_ += squared_distance(truth[i], mean);
  }
}

double KgError::percent() const {
  if (denominator_ > 0) return 100 * std::sqrt(numerator_ / denominator_);
  return numerator_ > 0 ? std::numeric_limits<double>::infinity() : 0;
}

}  // namespace eigencast
