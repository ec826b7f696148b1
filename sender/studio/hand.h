// SPDX-License-Identifier: MIT
#pragma once

#include <string_view>

#include "sender/studio/gizmo.h"
#include "view/glfw_window.h"

namespace eigencast::studio {

enum class Command {
  kMove,  // the tools, in the order of Tool
  kRotate,
  kScale,
  kTwist,
  kBend,
  kChooseAll,
  kChooseNone,
  kUndo,
  kRedo,
  kReset,
  kHome,
  kShow,
  kCage,
  kEdges,
  kFigures,
  kHelp,
  kQuit
};
std::optional<Command> command_for_key(std::string_view key, const Modifiers& modifiers);

/// A left drag of a handle moves the choice, of a knob applies the tool; beside both it turns the camera, or with Shift
/// draws a rectangle of choice. Middle and right drags move the camera. Pure state. Not thread-safe.
class Hand {
 public:
  /// Both must outlive it.
  Hand(Editor& editor, Camera& camera) : editor_(editor), camera_(camera) {}

  void press(MouseButton button, const glm::vec2& mouse, const Modifiers& modifiers);
  void move(const glm::vec2& mouse);
  void release(MouseButton button);
  void wheel(float steps);
  /// False: a command of the window.
  bool command(Command command);

  Tool tool() const { return tool_; }
  const glm::vec2& mouse() const { return mouse_; }
  Markup markup(std::span<const Face> handle_faces) const;

 private:
  enum class Doing { kNothing, kHandles, kKnob, kTurning, kPanning, kChoosing };
  void press_left(const Modifiers& modifiers);
  Gizmo gizmo() const { return gizmo_at(camera_, editor_.centre()); }

  Editor& editor_;
  Camera& camera_;
  Tool tool_ = Tool::kMove;
  Doing doing_ = Doing::kNothing;
  MouseButton button_ = MouseButton::kLeft;
  glm::vec2 mouse_{0}, pressed_{0};
  bool moved_ = false;    ///< Farther than a click.
  Vec3 held_{};           ///< Position of the dragged handle at the press.
  Gizmo grabbed_;         ///< At the press of its knob.
  std::size_t axis_ = 0;  ///< For the pressed knob.
};

}  // namespace eigencast::studio
