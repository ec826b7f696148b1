// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/level_control.h"
#include "common/motion/playout.h"
#include "view/camera.h"
#include "view/glfw_window.h"
#include "view/level_of_detail.h"
#include "view/overlay.h"
#include "view/style.h"

namespace eigencast {

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
  kCleanScreenshot,
  kPanel,
  kTurntable,
  kRecord,
  kCopyCamera,
  kPaste,
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

/// The switches of the viewer, and requests (wanted, on) that the window takes and clears.
struct ViewerState {
  bool help = false, hud = true, panel = false;
  Style style;
  bool paused = false, quit = false;
  PlayoutSettings playout;
  int colourings_on = 0;  ///< Steps in wishes_for().
  bool resolver_wanted = false;
  bool screenshot_wanted = false;
  bool clean_screenshot_wanted = false;            ///< The scene alone, without background.
  bool turntable = false;                          ///< The camera circles the scene.
  bool recording = false;                          ///< Every picture is written.
  bool copy_wanted = false, paste_wanted = false;  ///< The camera to the clipboard; its content to the viewer.

  void apply(Action action, Camera& camera, LevelOfDetail& lod);
};

/// The action of a key as WindowListener names it. Shift counts with the keys of screenshots only: elsewhere some
/// keyboards need it to type a character.
std::optional<Action> action_for_key(std::string_view key, const Modifiers& modifiers = {});

std::vector<HelpLine> help_lines(const ViewerState& state, const Camera& camera, const LevelOfDetail& lod,
                                 ResolverKind resolver);

/// prefix + "_0001" + ending and up.
std::string next_free_name(const std::string& prefix, const std::string& ending);
std::string next_screenshot_name(const std::string& prefix);

}  // namespace eigencast
