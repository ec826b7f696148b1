// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/level_control.h"
#include "common/motion/playout.h"
#include "common/motion/timeline.h"
#include "view/camera.h"
#include "view/glfw_window.h"
#include "view/overlay.h"
#include "view/scene.h"
#include "view/style.h"

namespace eigencast {

/// The switches of the viewer, and requests (wanted, on) that the window takes and clears.
struct ViewerState {
  bool help = false, hud = true, panel = false;
  Style style;
  bool paused = false, quit = false;
  PlayoutSettings playout;
  // Of clips, see play_clips().
  double speed = 1;
  bool looping = true;
  int steps = 0;                  ///< Frames on, or back.
  std::optional<TimeUs> seek_us;  ///< Where to go on.
  bool live_wanted = false;       ///< Streams go on, clips to their last pose.
  int colourings_on = 0;          ///< Steps in wishes_for().
  bool resolver_wanted = false;
  bool screenshot_wanted = false;
  bool clean_screenshot_wanted = false;                                 ///< The scene alone, without background.
  bool turntable = false;                                               ///< The camera circles the scene.
  bool recording = false;                                               ///< Every picture is written.
  bool pin_wanted = false, lead_wanted = false, follow_wanted = false;  ///< In a room: lead and follow, or stop it.
  std::array<char, 512> note{};                                         ///< For the next pin.
  bool copy_wanted = false, paste_wanted = false;  ///< The camera to the clipboard; its content to the viewer.
};

/// What a key acts on.
struct KeyTarget {
  ViewerState& state;
  Camera& camera;
  LevelOfDetail& lod;
};
struct KeyCommand {
  std::string_view keys;  ///< As WindowListener names them, with spaces between; "Space".
  void (*apply)(const KeyTarget& on);
  Modifiers modifiers = {};
  bool repeats = false;  ///< While the key is held.
};
/// Null: none. Shift counts with the keys of screenshots only: elsewhere some keyboards need it to type a character.
const KeyCommand* command_for_key(std::string_view key, const Modifiers& modifiers = {});

std::vector<HelpLine> help_lines(const ViewerState& state, const Camera& camera, const LevelOfDetail& lod,
                                 ResolverKind resolver);

/// prefix + "_0001" + ending and up.
std::string next_free_name(const std::string& prefix, const std::string& ending);

/// A point of a surface of the scene, by the rows of its asset.
struct Hit {
  glm::vec3 at{0};  ///< In the scene.
  std::size_t surface = 0;
  std::array<std::uint32_t, 3> rows{};  ///< Of the triangle; of a point three times the same.
  glm::vec3 weights{0};                 ///< Barycentric.
};
/// The nearest point of a visible surface under a pixel: of a mesh where its triangles are hit, of a cloud a point
/// within its spacing. whole: the scene's sources; surfaces count with all vertices that have arrived, else as drawn.
std::optional<Hit> pick(const Scene& scene, const Camera& camera, const glm::vec2& at_px, int width_px, int height_px,
                        std::span<PoseSource* const> whole = {});

}  // namespace eigencast
