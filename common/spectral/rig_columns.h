// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/known_motion.h"
#include "common/surface/rig.h"

namespace eigencast {

/// Columns that span every pose of a rigged surface. With p the bind pose: w_j and w_j p for each bone j in use, and w_j d
/// for each morph target d that moves its vertices. p and d are about the bind pose's middle, in units of half its
/// diagonal. Errors: kTooLarge (more columns or bytes than SpanningColumns takes).
Result<SpanningColumns> columns_from_rig(const Rig& rig);

}  // namespace eigencast
