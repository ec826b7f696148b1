// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "view/pose_source.h"

namespace eigencast {

/// `source` with another one of the same asset as its truth: how far apart both surfaces are, computed from
/// coefficients. Of streams poses of one capture time are compared where both senders have one clock, else poses that
/// came at one time; a file follows the timeline of a file.
std::unique_ptr<PoseSource> compared(std::unique_ptr<PoseSource> source, std::unique_ptr<PoseSource> other);

}  // namespace eigencast
