// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/known_motion.h"
#include "common/surface/rig.h"

namespace eigencast {

/// Columns of which every pose of a rigged surface is made: with p the bind pose, for each bone j the columns w_j and
/// w_j p, and for each morph target that moves vertices of that bone w_j d. Bones that carry nothing give none. p and d
/// are about the bind pose's middle and in units of half its diagonal. Errors: kTooLarge (more columns, or bytes, than
/// SpanningColumns takes).
Result<SpanningColumns> columns_from_rig(const Rig& rig);

}  // namespace eigencast
