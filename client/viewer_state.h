// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/level_control.h"
#include "common/motion/playout.h"
#include "view/camera.h"
#include "view/level_of_detail.h"
#include "view/look.h"
#include "view/overlay.h"

namespace eigencast {

/// What a key can ask of the viewer.
enum class Action {
  kResetCamera,
  kHelp,
  kAxes,
  kGrid,
  kEdges,
  kWireframe,
  kPoints,
  kColouring,
  kColourMap,
  kLegend,
  kHud,
  kScreenshot,
  kFiner,
  kCoarser,
  kResolver,
  kPause,
  kPlayout,
  kSmoother,
  kMoreLive,
  kUpAxis,
  kQuit
};

/// The switches of the viewer, apart from any window.
struct ViewerState {
  bool help = false, hud = true;
  Look look;
  bool paused = false, quit = false;
  PlayoutSettings playout;
  bool colouring_wanted = false;   ///< The next of wishes_for(): whoever knows the source takes this and clears it.
  bool resolver_wanted = false;    ///< Another resolver: whoever holds it takes this and clears it.
  bool screenshot_wanted = false;  ///< Whoever draws next takes it and clears this.

  /// Does what the action asks, to itself, the camera or the level of detail.
  void apply(Action action, Camera& camera, LevelOfDetail& lod);
};

/// The action of a key: upper-case letters, '+', '-', ',', '.', ' ', or a name ("Home", "F1", "F12", "Escape").
std::optional<Action> action_for_key(std::string_view key);

std::vector<HelpLine> help_lines(const ViewerState& state, const Camera& camera, const LevelOfDetail& lod,
                                 ResolverKind resolver);

/// The next of budget, paper, none, as key A goes round them.
ResolverKind next_kind(ResolverKind kind);

/// prefix + "_0001.png" and up: the first name that is not taken in the folder.
std::string next_screenshot_name(const std::string& prefix);

}  // namespace eigencast
