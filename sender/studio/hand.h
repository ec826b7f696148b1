// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "common/core/clock.h"
#include "sender/studio/editor.h"
#include "view/camera.h"
#include "view/glfw_window.h"
#include "view/markup.h"

/// Mouse positions are pixels from the upper left corner; points are in the scene.
namespace eigencast::studio {

/// At once if nothing was sent for an interval, otherwise at its end, so that the last pose of a gesture is always
/// sent; and a heartbeat while nothing moves.
class SendPace {
 public:
  SendPace(TimeUs interval_us, TimeUs heartbeat_us) : interval_us_(interval_us), heartbeat_us_(heartbeat_us) {}

  void changed() { waiting_ = true; }
  /// May lie in the past.
  TimeUs due_us(TimeUs now_us) const {
    if (!sent_us_) return now_us;
    return *sent_us_ + (waiting_ ? interval_us_ : std::max(interval_us_, heartbeat_us_));
  }
  void sent(TimeUs now_us) {
    sent_us_ = now_us;
    waiting_ = false;
  }

 private:
  TimeUs interval_us_, heartbeat_us_;
  std::optional<TimeUs> sent_us_;
  bool waiting_ = false;
};

inline constexpr float kReachPx = 12;  ///< Radius within which the mouse takes a handle.

glm::vec3 glm_from(const Vec3& p);

/// The nearest to the camera within kReachPx of the mouse.
std::optional<std::uint32_t> handle_at(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& mouse);
/// Hidden ones included.
std::vector<std::uint32_t> handles_within(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& corner,
                                          const glm::vec2& opposite);

void frame(Camera& camera, const glm::vec3& low, const glm::vec3& high, std::span<const Vec3> handles);

/// Returns the shift of a point that follows the mouse in the plane that faces the camera.
Vec3 shift_in_view(const Camera& camera, const Vec3& point, const glm::vec2& from, const glm::vec2& to);

struct Gizmo {
  Vec3 centre{};
  double length = 1;  ///< From centre to knob.
  Vec3 knob(std::size_t axis) const;
};
/// Has a constant size on the screen.
Gizmo gizmo_at(const Camera& camera, const Vec3& centre);
std::optional<std::size_t> knob_at(const Camera& camera, const Gizmo& gizmo, const glm::vec2& mouse);

/// Applies a drag to the editor's gesture: moves or scales along the knob's axis; turns about it by half a turn for
/// each kHalfTurnPx across it.
inline constexpr float kHalfTurnPx = 300;
void drag_knob(Editor& editor, Tool tool, const Camera& camera, const Gizmo& gizmo, std::size_t axis,
               const glm::vec2& from, const glm::vec2& to);

/// `handle_faces` may be empty; the `hovered` handle is drawn larger.
Markup markup_of(const Editor& editor, std::span<const Face> handle_faces, Tool tool, const Gizmo& gizmo,
                 std::optional<std::uint32_t> hovered);

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
