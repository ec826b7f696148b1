// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <memory>
#include <utility>

#include "common/surface/shapes/shapes.h"

namespace eigencast {

/// Twenty frames of the heart, its vertices in another order from frame `from` on.
class Reordered final : public MotionClip {
 public:
  explicit Reordered(std::size_t from) : clip_(std::move(*builtin_clip("heart"))), from_(from) {}
  const Surface& rest() const override { return clip_->rest(); }
  std::size_t frame_count() const override { return 20; }
  double frame_rate_hz() const override { return 30; }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    auto pose = clip_->pose(frame);
    if (pose && frame >= from_) std::reverse(pose->begin(), pose->end());
    return pose;
  }
  std::string name() const override { return "reordered"; }

 private:
  std::unique_ptr<MotionClip> clip_;
  std::size_t from_;
};

}  // namespace eigencast
