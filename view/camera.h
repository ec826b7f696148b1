// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

namespace eigencast {

/// An orbit camera in scene units, upright with respect to one axis. Mouse positions are pixels from the upper left
/// corner. Not thread-safe.
class Camera {
 public:
  enum class Up { kX, kY, kZ };
  static constexpr float kFieldOfView = 0.61F;  ///< Vertical, radians (35 degrees).

  /// Sets the scene's box, and points of it that home() frames (none: the box's corners); frames them unless the user
  /// has moved the camera. REQUIRES: low <= high.
  void set_scene(const glm::vec3& low, const glm::vec3& high, std::span<const glm::vec3> points = {});
  void set_up(Up up);
  Up up() const { return up_; }
  glm::vec3 up_vector() const;
  void set_viewport(int width_px, int height_px);

  void home();
  /// "front", "back", "left", "right", "top", "bottom" or "iso" (default): false if the name is none of these.
  bool set_view(std::string_view name);

  void rotate(const glm::vec2& drag_px);
  /// Turns about the up axis, counter-clockwise seen from above.
  void turn(float radians);
  void pan(const glm::vec2& drag_px);
  /// Goes nearer by wheel steps (> 0) and keeps the point under the cursor there.
  void zoom(float steps, const glm::vec2& cursor_px);
  void look_at(const glm::vec3& target) { target_ = target; }
  /// Moves to `eye`, looking at `target`; straight up and down are avoided. REQUIRES: they differ.
  void look_from(const glm::vec3& eye, const glm::vec3& target);

  glm::mat4 view_from_scene() const;
  glm::mat4 clip_from_view() const;
  glm::vec3 position() const { return target_ + distance_ * offset_direction(); }
  glm::vec3 target() const { return target_; }
  float distance() const { return distance_; }
  float scene_radius() const { return radius_; }
  glm::vec3 scene_low() const { return low_; }
  glm::vec3 scene_high() const { return high_; }
  glm::vec3 scene_centre() const { return 0.5F * (low_ + high_); }
  std::optional<glm::vec2> pixel_from_scene(const glm::vec3& point) const;
  glm::vec3 direction_through(const glm::vec2& pixel) const;
  /// The length of a pixel at the depth of a point. REQUIRES: the point is before the camera.
  float scene_per_px(const glm::vec3& point) const;
  /// Diameter of a ball on the screen, at most the picture's diagonal; 0 if the ball is out of sight.
  double diameter_px(const glm::vec3& centre, float radius) const;
  /// Upper bound of the pixels per scene unit on a ball; infinite around the eye.
  double max_px_per_unit(const glm::vec3& centre, float radius) const;

 private:
  glm::vec3 offset_direction() const;     ///< From target to camera, unit length.
  std::array<glm::vec3, 3> axes() const;  ///< Right, above, back; unit length.

  glm::vec3 low_{-1}, high_{1}, target_{0};
  std::vector<glm::vec3> framed_;
  Up up_ = Up::kY;
  float radius_ = 1.7320508F;
  float distance_ = 5;
  float azimuth_ = 0.6F, elevation_ = 0.3F;
  float home_azimuth_ = 0.6F, home_elevation_ = 0.3F;
  int width_ = 1280, height_ = 720;
  bool moved_ = false;
};

/// A box along the axes; empty until a point is added.
struct Bounds {
  glm::vec3 low{std::numeric_limits<float>::max()}, high{std::numeric_limits<float>::lowest()};
  bool empty() const { return low.x > high.x; }
  void add(const glm::vec3& point);
  std::array<glm::vec3, 8> corners() const;
};

/// Pixels of a picture from the lower left: from x and y on, as glScissor() takes them.
struct PixelBox {
  int x = 0, y = 0, width = 0, height = 0;
  bool empty() const { return width <= 0 || height <= 0; }
  bool operator==(const PixelBox&) const = default;
  /// The smallest that holds both.
  PixelBox with(const PixelBox& other) const;
  /// What is left of a picture without this box: below, above, left and right of it; some may be empty.
  std::array<PixelBox, 4> around(int picture_width, int picture_height) const;
};

/// The pixels that the hull of these points covers, with `margin` pixels around; all where one is behind the eye.
PixelBox pixels_of(std::span<const glm::vec3> points, const glm::mat4& clip_from_scene, int width, int height,
                   float margin);

}  // namespace eigencast
