// SPDX-License-Identifier: MIT
#include "sdk/bake_parts.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstdint>

#include "common/asset/asset_limits.h"
#include "common/asset/format/manifest.h"
#include "common/asset/tiles/basis_tile.h"
#include "common/core/worker_team.h"
#include "common/reconstruction/reconstruct.h"
#include "common/spectral/tangent_derivatives.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

using Vector = std::array<double, 3>;

// Bound the errors of derivatives, whose size is about one: frames and normals turn by at most kMaxError.
constexpr double kMinError = 1e-3, kMaxError = 1e-2;
constexpr std::size_t kRowsAtOnce = 256;

/// Returns the rest pose in rows' order, in the asset's space.
std::vector<Vec3> rest_rows(const Asset& asset, const Surface& surface) {
  std::vector<Vec3> rows(asset.vertex_count);
  for (std::size_t row = 0; row < rows.size(); ++row) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      rows[row][axis] = surface.positions[asset.source_vertex[row]][axis] - asset.origin[axis];
  }
  return rows;
}

std::vector<Vec3> base_rows(const Asset& asset) {
  std::vector<Vec3> rows(asset.vertex_count);
  for_each_shared(rows.size(), kRowsAtOnce, [&](std::size_t row) {
    for (std::size_t k = 0; k < asset.rank; ++k) {
      const double entry = double{asset.entry(row, k)};
      for (std::size_t axis = 0; axis < 3; ++axis) rows[row][axis] += entry * asset.rest[3 * k + axis];
    }
  });
  return rows;
}

std::vector<std::array<float, 3>> normal_rows(const Asset& asset, std::span<const Vec3> rest,
                                              std::span<const Vec3> of_points) {
  std::vector<std::array<float, 3>> rows(rest.size());
  if (asset.is_point_cloud()) {
    for (std::size_t row = 0; row < rows.size(); ++row) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        rows[row][axis] = static_cast<float>(of_points[asset.source_vertex[row]][axis]);
    }
    return rows;
  }
  std::vector<float> positions, normals(3 * rest.size());
  for (const Vec3& p : rest) positions.insert(positions.end(), {float(p[0]), float(p[1]), float(p[2])});
  vertex_normals(positions, triangles_at_level(asset, asset.vertex_count), normals);
  for (std::size_t row = 0; row < rows.size(); ++row) std::copy_n(&normals[3 * row], 3, rows[row].begin());
  return rows;
}

/// Has all columns at each row, made at each request: as floats they would be twice the basis.
class Derivatives {
 public:
  Derivatives(const Asset& asset, std::span<const Vec3> base)
      : asset_(asset), stencils_(tangent_derivatives(base, asset.faces, asset.map)) {}

  /// Calls use(row, along_x, along_y) for all rows; spans of r floats.
  template <typename Use>
  void for_all(const Use& use) const {
    const std::size_t r = asset_.rank;
    for_each_shared(asset_.vertex_count, kRowsAtOnce, [&](std::size_t row) {
      thread_local std::vector<float> room;
      room.assign(2 * r, 0);
      float* along_x = room.data();
      float* along_y = along_x + r;
      for (const TangentDerivatives::Term& term : stencils_.of(row)) {
        const float* psi = &asset_.floats[term.vertex * r];
        const auto x = static_cast<float>(term.along_x), y = static_cast<float>(term.along_y);
        for (std::size_t k = 0; k < r; ++k) {
          along_x[k] += x * psi[k];
          along_y[k] += y * psi[k];
        }
      }
      use(row, std::span<const float>(along_x, r), std::span<const float>(along_y, r));
    });
  }

 private:
  const Asset& asset_;
  TangentDerivatives stencils_;
};

/// The steps with which the rounding of all columns adds up to `error`, or the finest of 16 bits.
std::vector<float> steps_of(const Asset& asset, const Derivatives& derivatives, const AssetEncoding& encoding,
                            double error) {
  const std::size_t r = asset.rank;
  // Each run of rows has its own, so that threads share nothing.
  std::vector<std::vector<float>> largest((asset.vertex_count + kRowsAtOnce - 1) / kRowsAtOnce,
                                          std::vector<float>(r, 0.0F));
  derivatives.for_all([&](std::size_t row, std::span<const float> along_x, std::span<const float> along_y) {
    std::vector<float>& here = largest[row / kRowsAtOnce];
    for (std::size_t k = 0; k < r; ++k) here[k] = std::max({here[k], std::abs(along_x[k]), std::abs(along_y[k])});
  });
  std::vector<float> steps(r, 0.0F);
  for (std::size_t k = 0; k < r; ++k) {
    for (const std::vector<float>& part : largest) steps[k] = std::max(steps[k], part[k] / IntegerColumns::kLargest);
    if (steps[k] < asset_limits::kMinColumnScale) {
      steps[k] = 0;
    } else if (encoding.amplitudes.size() == r) {
      const double step = error * std::sqrt(12.0 / static_cast<double>(r)) / std::max(encoding.amplitudes[k], 1e-30);
      steps[k] = std::max(steps[k], static_cast<float>(std::min(step, double{asset_limits::kMaxColumnScale})));
    }
  }
  return steps;
}

}  // namespace

Asset::Detail detail_from(DetailKind kind, const Asset& asset, const Surface& surface, std::span<const Vec3> normals,
                          const AssetEncoding& encoding) {
  assert(kind != DetailKind::kNone);
  const std::size_t n = asset.vertex_count, r = asset.rank;
  const std::vector<Vec3> rest = rest_rows(asset, surface), base = base_rows(asset);
  const std::vector<std::array<float, 3>> outward = normal_rows(asset, rest, normals);
  const Derivatives derivatives(asset, base);
  const double missing = rms_distance(rest, base);
  const double error = std::clamp(missing > 0 ? encoding.error / missing : kMaxError, kMinError, kMaxError);

  Asset::Detail detail;
  detail.axes = kind == DetailKind::kNormal ? 1 : 3;
  detail.steps = steps_of(asset, derivatives, encoding, error);
  detail.along_x.resize(n * r);
  detail.along_y.resize(n * r);
  detail.offset.resize(n);
  detail.normal.resize(n);
  derivatives.for_all([&](std::size_t row, std::span<const float> along_x, std::span<const float> along_y) {
    Vector u{}, v{};  // of the rest pose, as readers find them
    const auto round = [&](std::span<const float> along, std::vector<std::int16_t>& to, Vector& derivative) {
      for (std::size_t k = 0; k < r; ++k) {
        const std::int16_t entry = to[row * r + k] = IntegerColumns::integer_from(along[k], detail.steps[k]);
        for (std::size_t axis = 0; axis < 3; ++axis)
          derivative[axis] += static_cast<double>(entry) * double{detail.steps[k]} * asset.rest[3 * k + axis];
      }
    };
    round(along_x, detail.along_x, u);
    round(along_y, detail.along_y, v);
    const auto frame = frame_from_derivatives(u, v);
    Vector offset{};
    for (std::size_t axis = 0; axis < 3; ++axis) offset[axis] = rest[row][axis] - base[row][axis];
    offset = frame.to_frame(offset);
    const auto& [x, y, z] = outward[row];
    const Vector normal = frame.to_frame({double{x}, double{y}, double{z}});
    const bool known = x != 0 || y != 0 || z != 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (axis == 2 || detail.axes == 3) detail.offset[row][axis] = static_cast<float>(offset[axis]);
      detail.normal[row][axis] = known ? static_cast<float>(normal[axis]) : axis == 2 ? 1.0F : 0.0F;
    }
  });
  return detail;
}

}  // namespace eigencast
