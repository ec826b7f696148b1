// SPDX-License-Identifier: MIT
#pragma once

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "sender/evaluate.h"

namespace eigencast {

/// As a live stream learns, poses one by one: nothing looks ahead. REQUIRES: options.learn; the clip has frames.
/// Errors: as evaluate(); kUnsupported (Learner::check).
Result<LearnEvaluation> evaluate_learning(const MotionClip& clip, const Asset& asset, const EvaluateOptions& options,
                                          const BakeProgress& progress);

}  // namespace eigencast
