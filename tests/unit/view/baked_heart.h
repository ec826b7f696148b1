// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include "common/reconstruction/reconstruct.h"
#include "common/surface/motion_clip.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "tests/unit/view/fake_source.h"

namespace eigencast::testing {

/// The built-in heart, baked once in this process.
inline const Asset& baked_heart() {
  static const Asset asset = [] {
    const auto clip = builtin_clip("heart");
    const KnownMotion motion = motion_of(**clip);
    BakeOptions options;
    options.motion = &motion;
    auto result = bake((*clip)->rest(), options);
    EXPECT_TRUE(result) << result.error().message;
    return std::move(result->asset);
  }();
  return asset;
}

/// The heart `seconds` into its clip, as a received key.
inline ReceivedPose heart_pose(double seconds, TimeUs time_us) {
  static const auto clip = builtin_clip("heart");
  static const Projector projector = Projector::create(baked_heart()).value();
  const auto positions = (*clip)->pose(static_cast<std::size_t>(seconds * (*clip)->frame_rate_hz())).value();
  ReceivedPose pose = sphere_pose(baked_heart(), 1, time_us, 1);
  const std::span<const double> values(positions.front().data(), 3 * positions.size());
  pose.coefficients = projector.coefficients_from_positions(values).value();
  return pose;
}

}  // namespace eigencast::testing
