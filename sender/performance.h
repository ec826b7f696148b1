// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "sender/clip_coefficients.h"
#include "sender/evaluate.h"

namespace eigencast {

/// The coefficients of a clip that is played at another speed, by a cubic through its poses, a little differently.
class Performance {
 public:
  Performance(const CoefficientStore& clip, std::size_t frames, const Asset& asset, const AgainOptions& options)
      : clip_(clip),
        last_(static_cast<double>(frames - 1)),
        warp_(options.warp),
        spread_(options.noise * asset.diagonal() * std::sqrt(asset.area / (3.0 * asset.rank))) {}

  /// A pose of it: a blend of the clip's, and what differs.
  struct Pose {
    std::vector<double> C;  ///< All in all.
    std::array<std::size_t, 4> frames{};
    std::array<double, 4> weights{};
    std::vector<double> noise;  ///< As C.
  };

  /// Nothing when the pass is over.
  Result<std::optional<Pose>> next() {
    const double time = warp_ * static_cast<double>(frame_++);
    if (time > last_) return std::optional<Pose>();
    const auto from = static_cast<std::int64_t>(time), last = static_cast<std::int64_t>(last_);
    const double t = time - std::floor(time), rest = 1 - t;  // Catmull & Rom
    Pose pose;
    pose.weights = {-t * rest * rest / 2, ((3 * t - 5) * t * t + 2) / 2, ((4 - 3 * t) * t + 1) * t / 2,
                    -t * t * rest / 2};
    for (std::size_t k = 0; k < 4; ++k) {
      pose.frames[k] =
          static_cast<std::size_t>(std::clamp<std::int64_t>(from - 1 + static_cast<std::int64_t>(k), 0, last));
      const auto C = clip_.at(pose.frames[k]);
      if (!C) return C.error();
      pose.C.resize(C->size());
      for (std::size_t i = 0; i < C->size(); ++i) pose.C[i] += pose.weights[k] * (*C)[i];
    }
    for (double& c : pose.C) c += pose.noise.emplace_back(spread_ * normal_(random_));
    return std::optional(std::move(pose));
  }
  void restart() { frame_ = 0; }

 private:
  const CoefficientStore& clip_;
  double last_, warp_, spread_;
  std::uint64_t frame_ = 0;
  std::mt19937_64 random_{1};
  std::normal_distribution<double> normal_;
};

}  // namespace eigencast
