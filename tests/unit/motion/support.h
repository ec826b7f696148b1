// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/clock.h"

namespace eigencast {

inline constexpr TimeUs kMs = 1000;
/// The sender's clock has nothing to do with ours.
inline constexpr TimeUs kSenderZero = 1'700'000'000'000'000;

}  // namespace eigencast
