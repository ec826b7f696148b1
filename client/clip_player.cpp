// SPDX-License-Identifier: MIT
#include "client/clip_player.h"

#include <algorithm>
#include <utility>

namespace eigencast {

Timeline* leading_timeline(std::span<PoseSource* const> sources) {
  Timeline* lead = nullptr;
  for (const PoseSource* source : sources) {
    Timeline* timeline = source->timeline();
    const bool moves = timeline != nullptr && timeline->times_us().size() > 1;
    if (moves && (lead == nullptr || timeline->period_us() > lead->period_us())) lead = timeline;
  }
  return lead;
}

void play_clips(std::span<PoseSource* const> sources, ViewerState& state, TimeUs now_us) {
  const int steps = std::exchange(state.steps, 0);
  const bool to_end = std::exchange(state.live_wanted, false);
  const std::optional<TimeUs> seek_us = std::exchange(state.seek_us, std::nullopt);
  const Timeline* lead = leading_timeline(sources);
  // A stream goes on where it is now; a clip has nothing after its last pose.
  const auto is_clip = [](const PoseSource* source) { return source->timeline() != nullptr; };
  if (to_end) state.paused = lead != nullptr && std::all_of(sources.begin(), sources.end(), is_clip);
  if (lead == nullptr) return;
  if (steps != 0) state.paused = true;
  const bool ended = !lead->looping() && !lead->paused() && !lead->until_next_us(now_us);
  const bool anew = ended && state.paused && steps == 0 && !to_end && !seek_us;
  if (anew) state.paused = false;
  for (const PoseSource* source : sources) {
    Timeline* timeline = source->timeline();
    if (timeline == nullptr) continue;
    timeline->set_looping(state.looping, now_us);
    timeline->set_speed(state.speed, now_us);
    timeline->set_interpolates(state.playout.mode != PlayoutMode::kLatest || state.speed < 1);
    timeline->set_paused(state.paused, now_us);
    if (anew) timeline->seek(0, now_us);
    if (to_end) timeline->seek(timeline->end_us(), now_us);
    if (seek_us) timeline->seek(state.looping ? *seek_us % timeline->period_us() : *seek_us, now_us);
    if (steps != 0) timeline->step(steps, now_us);
  }
}

}  // namespace eigencast
