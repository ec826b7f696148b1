// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <vector>

#include "common/core/clock.h"
#include "common/motion/coefficients.h"
#include "common/wire/envelope.h"

namespace eigencast {

struct ReceivedPose {
  Envelope envelope;          ///< As it came; `bands` are those that the pose has, also for steps.
  TimeUs arrival_us = 0;      ///< Steady clock, when the last byte was read.
  TimeUs decoded_us = 0;      ///< Likewise, when it was decoded.
  Coefficients coefficients;  ///< Absent bands read as the rest pose (docs/protocol.md).
  std::uint32_t channels = 3;
  std::vector<std::uint32_t> band_ends = {};  ///< The row at which each band ends, as announced with the pose.
};

}  // namespace eigencast
