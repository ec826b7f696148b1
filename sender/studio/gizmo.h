// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "sender/studio/editor.h"
#include "view/camera.h"
#include "view/markup.h"

/// Mouse positions are pixels from the upper left corner; points are in the scene.
namespace eigencast::studio {

inline constexpr float kReachPx = 12;  ///< Radius within which the mouse takes a handle.

glm::vec3 glm_from(const Vec3& p);

/// The nearest to the camera within kReachPx of the mouse.
std::optional<std::uint32_t> handle_at(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& mouse);
/// Hidden ones included.
std::vector<std::uint32_t> handles_within(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& corner,
                                          const glm::vec2& opposite);

void frame(Camera& camera, const glm::vec3& low, const glm::vec3& high, std::span<const Vec3> handles);

/// Of a point that follows the mouse in the plane that faces the camera.
Vec3 shift_in_view(const Camera& camera, const Vec3& point, const glm::vec2& from, const glm::vec2& to);

struct Gizmo {
  Vec3 centre{};
  double length = 1;  ///< From centre to knob.
  Vec3 knob(std::size_t axis) const;
};
/// Has a constant size on the screen.
Gizmo gizmo_at(const Camera& camera, const Vec3& centre);
std::optional<std::size_t> knob_at(const Camera& camera, const Gizmo& gizmo, const glm::vec2& mouse);

/// Applies a drag to the editor's gesture: moves or scales along the knob's axis; turns about it by half a turn for each
/// kHalfTurnPx across it.
inline constexpr float kHalfTurnPx = 300;
void drag_knob(Editor& editor, Tool tool, const Camera& camera, const Gizmo& gizmo, std::size_t axis,
               const glm::vec2& from, const glm::vec2& to);

/// `handle_faces` may be empty; the `hovered` handle is drawn larger.
Markup markup_of(const Editor& editor, std::span<const Face> handle_faces, Tool tool, const Gizmo& gizmo,
                 std::optional<std::uint32_t> hovered);

}  // namespace eigencast::studio
