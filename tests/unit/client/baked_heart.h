// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "client/clip_source.h"

namespace eigencast::testing {

/// The built-in heart, baked once in this process.
inline std::shared_ptr<const BakedClip> baked_heart() {
  static const auto clip = BakedClip::open("heart", "");
  EXPECT_TRUE(clip) << clip.error().message;
  return *clip;
}

}  // namespace eigencast::testing
