// SPDX-License-Identifier: MIT
#include "view/camera.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <limits>
#include <utility>

namespace eigencast {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kSteepest = 0.5F * kPi - 1e-3F;  // the view would turn over at the poles
constexpr float kRadiansPerPixel = 0.0065F;
constexpr float kZoomPerStep = 1.15F;
constexpr float kFramedPart = 2.0F / 3;  // of the window
constexpr int kCentringSteps = 5;

struct NamedView {
  std::string_view name;
  float azimuth, elevation;
};
constexpr std::array<NamedView, 7> kViews{{{"iso", 0.6F, 0.3F},
                                           {"front", 0, 0},
                                           {"right", 0.5F * kPi, 0},
                                           {"back", kPi, 0},
                                           {"left", -0.5F * kPi, 0},
                                           {"top", 0, kSteepest},
                                           {"bottom", 0, -kSteepest}}};

}  // namespace

void Camera::set_scene(const glm::vec3& low, const glm::vec3& high, std::span<const glm::vec3> points) {
  assert(low.x <= high.x && low.y <= high.y && low.z <= high.z);
  low_ = low;
  high_ = high;
  radius_ = std::max(0.5F * glm::length(high - low), 1e-20F);
  framed_.assign(points.begin(), points.end());
  for (int corner = 0; corner < 8 && points.empty(); ++corner)
    framed_.emplace_back(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y, corner & 4 ? high.z : low.z);
  if (!moved_) home();
}

void Camera::set_up(Up up) {
  up_ = up;
  home();
}

glm::vec3 Camera::up_vector() const {
  return up_ == Up::kX ? glm::vec3(1, 0, 0) : up_ == Up::kY ? glm::vec3(0, 1, 0) : glm::vec3(0, 0, 1);
}

void Camera::set_viewport(int width_px, int height_px) {
  width_ = std::max(width_px, 1);
  height_ = std::max(height_px, 1);
  if (!moved_) home();
}

void Camera::home() {
  Bounds framed;
  for (const glm::vec3& point : framed_) framed.add(point);
  target_ = framed.empty() ? 0.5F * (low_ + high_) : 0.5F * (framed.low + framed.high);
  azimuth_ = home_azimuth_;
  elevation_ = home_elevation_;
  moved_ = false;
  // The points, not a ball around them, decide the distance: each pair of sides of a pyramid touches them.
  const auto [right, above, back] = axes();
  const auto reach = [&, back = back](const glm::vec3& axis, float slope) {
    float farthest = 0;
    const glm::vec3 side = axis + slope * back;
    for (const glm::vec3& point : framed_) farthest = std::max(farthest, glm::dot(point - target_, side));
    return farthest;
  };
  const float slope_y = kFramedPart * std::tan(0.5F * kFieldOfView);
  const float slope_x = slope_y * static_cast<float>(width_) / static_cast<float>(height_);
  const std::array<std::pair<glm::vec3, float>, 2> sides{{{right, slope_x}, {above, slope_y}}};
  distance_ = 1e-3F * radius_;
  for (const auto& [axis, slope] : sides)
    distance_ = std::max(distance_, 0.5F * (reach(axis, slope) + reach(-axis, slope)) / slope);
  // The direction that needs less gets narrower sides until they touch, too: so the points are in the middle.
  for (auto [axis, slope] : sides) {
    float one = 0, other = 0;
    for (int step = 0; step < kCentringSteps; ++step, slope = 0.5F * (one + other) / distance_) {
      one = reach(axis, slope);
      other = reach(-axis, slope);
    }
    target_ += 0.5F * (one - other) * axis;
  }
}

bool Camera::set_view(std::string_view name) {
  const auto view = std::find_if(kViews.begin(), kViews.end(), [&](const NamedView& v) { return v.name == name; });
  if (view == kViews.end()) return false;
  home_azimuth_ = view->azimuth;
  home_elevation_ = view->elevation;
  home();
  return true;
}

void Camera::look_from(const glm::vec3& eye, const glm::vec3& target) {
  const glm::vec3 offset = eye - target;
  distance_ = std::max(glm::length(offset), 1e-6F * radius_);
  target_ = target;
  const glm::vec3 d = offset / distance_;
  const float above = glm::dot(d, up_vector());
  elevation_ = std::clamp(std::asin(std::clamp(above, -1.0F, 1.0F)), -kSteepest, kSteepest);
  // The inverse of offset_direction().
  azimuth_ = up_ == Up::kX ? std::atan2(d.y, d.z) : up_ == Up::kY ? std::atan2(d.x, d.z) : std::atan2(d.x, -d.y);
  moved_ = true;
}

void Camera::rotate(const glm::vec2& drag_px) {
  azimuth_ = std::remainder(azimuth_ - drag_px.x * kRadiansPerPixel, 2 * kPi);
  elevation_ = std::clamp(elevation_ + drag_px.y * kRadiansPerPixel, -kSteepest, kSteepest);
  moved_ = true;
}

void Camera::turn(float radians) {
  azimuth_ = std::remainder(azimuth_ + radians, 2 * kPi);
  moved_ = true;
}

void Camera::pan(const glm::vec2& drag_px) {
  const auto [right, above, back] = axes();
  const float scene_per_px = 2 * std::tan(0.5F * kFieldOfView) * distance_ / static_cast<float>(height_);
  target_ += scene_per_px * (-drag_px.x * right + drag_px.y * above);
  moved_ = true;
}

void Camera::zoom(float steps, const glm::vec2& cursor_px) {
  const float nearest = 0.02F * radius_, farthest = 60 * radius_;
  const float wanted = std::clamp(distance_ * std::pow(kZoomPerStep, -steps), nearest, farthest);
  const float shrink = wanted / distance_;
  // A point at the target's depth keeps its pixel if the target moves towards it by the same ratio.
  const glm::vec2 from_centre = cursor_px - 0.5F * glm::vec2(width_, height_);
  pan(-(1 - shrink) * from_centre);
  distance_ = wanted;
}

std::array<glm::vec3, 3> Camera::axes() const {
  const glm::vec3 back = offset_direction();
  const glm::vec3 right = glm::normalize(glm::cross(up_vector(), back));
  return {right, glm::cross(back, right), back};
}

glm::vec3 Camera::offset_direction() const {
  const float c = std::cos(elevation_), s = std::sin(elevation_);
  const float a = c * std::sin(azimuth_), b = c * std::cos(azimuth_);
  return up_ == Up::kX ? glm::vec3(s, a, b) : up_ == Up::kY ? glm::vec3(a, s, b) : glm::vec3(a, -b, s);
}

glm::mat4 Camera::view_from_scene() const {
  return glm::lookAt(position(), target_, up_vector());
}

glm::mat4 Camera::clip_from_view() const {
  // The near plane is as far as the surface may come; the ratio stays small enough for a 24-bit depth buffer.
  const float to_centre = glm::length(position() - scene_centre());
  const float far_plane = to_centre + 9 * radius_;
  const float near_plane = std::max(to_centre - 2.5F * radius_, 1e-3F * far_plane);
  return glm::perspective(kFieldOfView, static_cast<float>(width_) / static_cast<float>(height_), near_plane,
                          far_plane);
}

std::optional<glm::vec2> Camera::pixel_from_scene(const glm::vec3& point) const {
  const glm::vec4 clip = clip_from_view() * view_from_scene() * glm::vec4(point, 1);
  if (clip.w <= 0) return std::nullopt;
  return glm::vec2((0.5F + 0.5F * clip.x / clip.w) * static_cast<float>(width_),
                   (0.5F - 0.5F * clip.y / clip.w) * static_cast<float>(height_));
}

glm::vec3 Camera::direction_through(const glm::vec2& pixel) const {
  const float height = static_cast<float>(height_), tan_y = std::tan(0.5F * kFieldOfView);
  const glm::vec2 from_centre = (pixel - 0.5F * glm::vec2(width_, height_)) * (2 * tan_y / height);
  const glm::vec3 in_view(from_centre.x, -from_centre.y, -1);
  return glm::normalize(glm::transpose(glm::mat3(view_from_scene())) * in_view);
}

float Camera::scene_per_px(const glm::vec3& point) const {
  const glm::vec3 in_view = glm::vec3(view_from_scene() * glm::vec4(point, 1));
  assert(in_view.z < 0);
  return -2 * std::tan(0.5F * kFieldOfView) * in_view.z / static_cast<float>(height_);
}

double Camera::max_px_per_unit(const glm::vec3& centre, float radius) const {
  const float nearest = glm::length(centre - position()) - radius;
  if (nearest <= 0) return std::numeric_limits<double>::infinity();
  return static_cast<double>(0.5F * static_cast<float>(height_) / std::tan(0.5F * kFieldOfView) / nearest);
}

double Camera::diameter_px(const glm::vec3& centre, float radius) const {
  const glm::vec3 p = glm::vec3(view_from_scene() * glm::vec4(centre, 1));
  const float tan_y = std::tan(0.5F * kFieldOfView);
  const float tan_x = tan_y * static_cast<float>(width_) / static_cast<float>(height_);
  const auto outside = [&](float across, float tangent) {  // distance from a side of the field of view
    return (std::abs(across) + tangent * p.z) / std::sqrt(1 + tangent * tangent);
  };
  if (-p.z < -radius || outside(p.x, tan_x) > radius || outside(p.y, tan_y) > radius) return 0;
  const float most = std::hypot(static_cast<float>(width_), static_cast<float>(height_));
  const float squared = glm::dot(p, p) - radius * radius;
  if (squared <= 0) return static_cast<double>(most);
  return static_cast<double>(std::min(most, radius / std::sqrt(squared) * static_cast<float>(height_) / tan_y));
}

void Bounds::add(const glm::vec3& point) {
  low = glm::min(low, point);
  high = glm::max(high, point);
}

std::array<glm::vec3, 8> Bounds::corners() const {
  std::array<glm::vec3, 8> all;
  for (std::size_t i = 0; i < 8; ++i)
    all[i] = {(i & 1) != 0 ? high.x : low.x, (i & 2) != 0 ? high.y : low.y, (i & 4) != 0 ? high.z : low.z};
  return all;
}

PixelBox PixelBox::with(const PixelBox& other) const {
  if (empty()) return other;
  if (other.empty()) return *this;
  const int left = std::min(x, other.x), lower = std::min(y, other.y);
  return {left, lower, std::max(x + width, other.x + other.width) - left,
          std::max(y + height, other.y + other.height) - lower};
}

std::array<PixelBox, 4> PixelBox::around(int picture_width, int picture_height) const {
  if (empty()) return {PixelBox{0, 0, picture_width, picture_height}};
  const int right = x + width, upper = y + height;
  return {PixelBox{0, 0, picture_width, y}, PixelBox{0, upper, picture_width, picture_height - upper},
          PixelBox{0, y, x, height}, PixelBox{right, y, picture_width - right, height}};
}

PixelBox pixels_of(std::span<const glm::vec3> points, const glm::mat4& clip_from_scene, int width, int height,
                   float margin) {
  const glm::vec2 size(width, height);
  glm::vec2 low(size), high(0);
  for (const glm::vec3& point : points) {
    const glm::vec4 clip = clip_from_scene * glm::vec4(point, 1);
    if (!(clip.w > 1e-6F)) return {0, 0, width, height};
    const glm::vec2 px = (0.5F + 0.5F * glm::vec2(clip) / clip.w) * size;
    low = glm::min(low, px - margin);
    high = glm::max(high, px + margin);
  }
  low = glm::clamp(glm::floor(low), glm::vec2(0), size);
  high = glm::clamp(glm::ceil(high), glm::vec2(0), size);
  const PixelBox box{static_cast<int>(low.x), static_cast<int>(low.y), static_cast<int>(high.x - low.x),
                     static_cast<int>(high.y - low.y)};
  return box.empty() ? PixelBox() : box;
}

}  // namespace eigencast
