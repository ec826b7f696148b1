// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string_view>

namespace eigencast {

/// An orbit camera: looks at a target from a distance, upright with respect to one axis of the scene. All in scene
/// units.
///
/// Mouse positions are in pixels from the upper left corner. Pure state: no window, no time. Not thread-safe.
class Camera {
 public:
  enum class Up { kX, kY, kZ };
  static constexpr float kFieldOfView = 0.61F;  ///< Vertical, radians (35 degrees).

  /// The box that home() frames; also moves there unless the user has already moved the camera. REQUIRES: low <= high.
  void set_scene(const glm::vec3& low, const glm::vec3& high);
  void set_up(Up up);
  Up up() const { return up_; }
  glm::vec3 up_vector() const;
  void set_viewport(int width_px, int height_px);

  /// Back to the first view: the whole box, from the direction of set_view().
  void home();
  /// "front", "back", "left", "right", "top", "bottom" or "iso" (default): false if the name is none of these.
  bool set_view(std::string_view name);

  void rotate(const glm::vec2& drag_px);
  /// Round the axis that is up, counter-clockwise seen from above; the distance stays.
  void turn(float radians);
  void pan(const glm::vec2& drag_px);
  /// One step of the wheel; what is under the cursor stays under it. steps > 0 goes nearer.
  void zoom(float steps, const glm::vec2& cursor_px);
  void look_at(const glm::vec3& target) { target_ = target; }
  /// Stands at `eye` and looks at `target`, upright; from straight above or below nearly so. REQUIRES: they differ.
  void look_from(const glm::vec3& eye, const glm::vec3& target);

  glm::mat4 view_from_scene() const;
  glm::mat4 clip_from_view() const;
  glm::vec3 position() const;
  glm::vec3 target() const { return target_; }
  float distance() const { return distance_; }
  float scene_radius() const { return radius_; }
  glm::vec3 scene_low() const { return low_; }
  glm::vec3 scene_high() const { return high_; }
  glm::vec3 scene_centre() const { return 0.5F * (low_ + high_); }
  /// Where a point of the scene lands, in pixels; nothing when it is behind the camera.
  std::optional<glm::vec2> pixel_from_scene(const glm::vec3& point) const;
  /// From the camera through a pixel: unit length.
  glm::vec3 direction_through(const glm::vec2& pixel) const;
  /// What a pixel is long in the plane of a point that faces the camera. REQUIRES: the point is before the camera.
  float scene_per_px(const glm::vec3& point) const;
  /// Diameter in pixels of a ball, at most that of the picture's; 0 if none of it can be in the picture.
  double diameter_px(const glm::vec3& centre, float radius) const;
  /// Pixels that one unit of the scene takes at most on a ball in it; infinite around the eye.
  double max_px_per_unit(const glm::vec3& centre, float radius) const;
  bool moved() const { return moved_; }

 private:
  glm::vec3 offset_direction() const;  ///< From target to camera, unit length.

  glm::vec3 low_{-1}, high_{1}, target_{0};
  Up up_ = Up::kY;
  float radius_ = 1.7320508F;
  float distance_ = 5;
  float azimuth_ = 0.6F, elevation_ = 0.3F;
  float home_azimuth_ = 0.6F, home_elevation_ = 0.3F;
  int width_ = 1280, height_ = 720;
  bool moved_ = false;
};

}  // namespace eigencast
