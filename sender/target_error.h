// SPDX-License-Identifier: MIT
#pragma once

#include "sender/source.h"

namespace eigencast {

/// Rms error that an asset's basis leaves on at most 24 sample poses of a clip, over the diagonal. Errors: those of the
/// clip; kInvalidArgument (a pose has another number of vertices).
Result<double> error_on_samples(const Asset& asset, const MotionClip& clip);

/// As bake_source, with the rank that options.target_error takes on the poses of options.poses or, without, of the
/// input; `rank` of the options is not used. Several bakes, all of which stay in the cache. Errors: those of
/// bake_source; kInvalidArgument where the largest rank does not do, there are no poses to judge by, or they are in
/// another order.
Result<Source> bake_for_target(const SourceOptions& options, const BakeProgress& progress);

}  // namespace eigencast
