// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <string_view>

#include "common/asset/asset.h"
#include "common/core/result.h"
#include "common/core/text.h"

namespace eigencast {

/// How other poses get back what the basis leaves out of the rest pose. In a pose, with b_i the position that the basis
/// gives vertex i and d_i what is missing there at rest:
enum class DetailKind {
  kNone,
  kNormal,  ///< x_i = b_i + (d_i . n_i at rest) n_i, along the normal of what the basis holds: the paper's.
  kFrames,  ///< x_i = b_i + R_i d_i, R_i the rotation nearest to how the surface round i has turned since rest.
};
inline constexpr EnumNames<DetailKind, 3> kDetailNames{{"none", "normal", "frames"}};
constexpr std::string_view name_of(DetailKind kind) {
  return kDetailNames[kind];
}
/// Errors: kInvalidArgument.
inline Result<DetailKind> detail_from_name(std::string_view name) {
  if (const auto kind = kDetailNames.find(name)) return *kind;
  return fail(ErrorCode::kInvalidArgument,
              "there is no detail '" + std::string(name) + "': use none, normal or frames");
}
/// What an asset brings.
inline DetailKind detail_of(const Asset& asset) {
  if (asset.detail.size() == 0) return DetailKind::kNone;
  return asset.detail.axes == 1 ? DetailKind::kNormal : DetailKind::kFrames;
}

/// Orthonormal axes at a vertex of a pose, which turn as the surface does.
template <typename Real>
struct DetailFrame {
  using Vector = std::array<Real, 3>;
  Vector x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};

  Vector from_frame(const Vector& v) const {
    Vector world{};
    for (std::size_t d = 0; d < 3; ++d) world[d] = v[0] * x[d] + v[1] * y[d] + v[2] * z[d];
    return world;
  }
  Vector to_frame(const Vector& v) const {
    const auto dot = [&v](const Vector& axis) { return axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]; };
    return {dot(x), dot(y), dot(z)};
  }
};

/// The frame whose x and y are nearest to two derivatives of the pose (in the sum of squares), z along their cross
/// product, whatever they are stretched and sheared by: of derivatives that are x and y at rest, frames turn from rest
/// to pose by the rotation of the polar decomposition of the deformation's gradient. The axes of the world where the
/// derivatives span no plane.
template <typename Real>
DetailFrame<Real> frame_from_derivatives(const std::array<Real, 3>& u, const std::array<Real, 3>& v) {
  const auto cross = [](const auto& a, const auto& b) {
    return std::array<Real, 3>{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  };
  const auto scaled = [](std::array<Real, 3> a) {
    const Real squared = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
    const Real scale = squared > 0 && std::isfinite(squared) ? 1 / std::sqrt(squared) : 0;
    for (Real& component : a) component *= scale;
    return a;
  };
  DetailFrame<Real> frame;
  const std::array<Real, 3> z = scaled(cross(u, v));
  if (z[0] == 0 && z[1] == 0 && z[2] == 0) return frame;
  const std::array<Real, 3> back = cross(v, z);  // v, a quarter turn back towards u
  frame.x = scaled(std::array<Real, 3>{u[0] + back[0], u[1] + back[1], u[2] + back[2]});
  frame.y = cross(z, frame.x);
  frame.z = z;
  return frame;
}

}  // namespace eigencast
