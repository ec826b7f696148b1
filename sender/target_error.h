// SPDX-License-Identifier: MIT
#pragma once

#include "sender/source.h"

namespace eigencast {

/// Over the diagonal, on at most 24 sample poses. Errors: the clip's; kInvalidArgument (another number of vertices).
Result<double> error_on_samples(const Asset& asset, const MotionClip& clip);

/// As bake_source, with the rank that options.target_error takes on options.poses or, without, the input. Errors: those of
/// bake_source; kInvalidArgument: the largest rank does not do, no poses to judge by, or they are in another order.
Result<Source> bake_for_target(const SourceOptions& options, const BakeProgress& progress);

}  // namespace eigencast
