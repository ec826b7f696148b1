// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>

#include "client/session.h"
#include "client/viewer_state.h"

namespace eigencast {

using TextField = std::array<char, 1024>;

struct UiRequests {
  std::string open;  ///< Empty: nothing.
  std::optional<std::size_t> remove;
};

/// Panel and gap, pixels.
inline float panel_width(float scale) {
  return 304 * scale;
}

/// The panel at the left. Changes state and session in place. REQUIRES: called while an Overlay draws.
/// Not thread-safe.
UiRequests draw_panel(Session& session, ViewerState& state, TextField& to_open, float scale);

/// A bar at the bottom that shows where a clip is, and seeks where it is dragged. Changes the state in place.
/// REQUIRES: as draw_panel.
void draw_timeline(const Timeline& timeline, ViewerState& state, TimeUs now_us, float scale);

/// Likewise where streams have a past: what is kept of it, gaps, where it is shown, and the live edge.
void draw_past(const RewindDesk::Bar& bar, ViewerState& state, float scale);

/// For an empty viewer. REQUIRES: as draw_panel.
UiRequests draw_welcome(const std::vector<std::string>& recent, TextField& to_open, float scale);

}  // namespace eigencast
