// SPDX-License-Identifier: MIT
#pragma once

#include <span>

#include "client/viewer_state.h"
#include "view/pose_source.h"

namespace eigencast {

/// The timeline of the longest clip that moves; null: there is none.
Timeline* leading_timeline(std::span<PoseSource* const> sources);

/// Plays all clips as the state says: pause, speed, loop; and does what it wants: steps, a seek, the end. A pause of
/// what has ended without loop begins it anew. Streams have no timeline and only pause.
void play_clips(std::span<PoseSource* const> sources, ViewerState& state, TimeUs now_us);

}  // namespace eigencast
