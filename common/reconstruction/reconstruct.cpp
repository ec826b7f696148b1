// SPDX-License-Identifier: MIT
#include "common/reconstruction/reconstruct.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <optional>
#include <vector>

#include "common/asset/detail.h"
#include "common/core/worker_team.h"
#include "common/reconstruction/corner_normals.h"
#include "common/reconstruction/kernel.h"

namespace eigencast {
namespace {

constexpr std::size_t kWorthThreadsToRebuild = 20'000'000;  // multiplications
constexpr std::size_t kTilesPerTask = 4;

/// Coefficients of poses as the kernel reads them.
class Packed {
 public:
  Packed(const BasisTiles& tiles, std::span<const PoseToRebuild> poses, std::uint32_t rank)
      : tiles_(tiles), rank_(rank) {
    for (const PoseToRebuild& pose : poses) {
      assert(pose.channels >= 3 && pose.C.size() >= std::size_t{rank} * pose.channels);
      auto& [C, whole] = poses_.emplace_back();
      C.resize(3 * (std::size_t{rank} + 1));
      for (std::uint32_t k = 0; k < rank; ++k) {
        for (std::size_t d = 0; d < 3; ++d) {
          C[3 * k + d] = static_cast<float>(pose.C[std::size_t{k} * pose.channels + d] * tiles.scale(k));
        }
      }
      whole = tiles.whole_coefficients(pose.C, pose.channels, rank);
    }
  }
  /// The product with the rows from a tile on.
  ///   rooms  output of each pose
  void multiply(const kernel::Functions& functions, std::size_t first_tile, std::size_t rows,
                std::span<const std::span<float>> rooms) const {
    std::vector<kernel::Pose> here(poses_.size());
    for (std::size_t p = 0; p < poses_.size(); ++p) {
      here[p].C = poses_[p].C.data();
      if (poses_[p].whole) {
        here[p].whole = poses_[p].whole->C.data();
        std::copy(poses_[p].whole->unit.begin(), poses_[p].whole->unit.end(), here[p].unit);
      }
      here[p].X = rooms[p].data();
    }
    functions.product(tiles_.view(first_tile, rank_), rows, here.data(), here.size());
  }

 private:
  struct PackedPose {
    std::vector<float> C;  // x 3, in units of the tiles' entries; zero beyond the last column
    std::optional<WholeCoefficients> whole;
  };

  const BasisTiles& tiles_;
  std::uint32_t rank_;
  std::vector<PackedPose> poses_;
};

std::span<float> part_of(std::span<float> values, std::size_t row, std::size_t rows) {
  return values.empty() ? values : values.subspan(3 * row, 3 * rows);
}

using Vector = std::array<float, 3>;

Vector point(std::span<const float> positions, std::size_t i) {
  assert(3 * i + 3 <= positions.size());
  const float* at = &positions[3 * i];
  return {at[0], at[1], at[2]};
}
Vector minus(const Vector& a, const Vector& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
/// Zero for a zero vector.
Vector unit(const Vector& a) {
  const float length = std::hypot(a[0], a[1], a[2]);
  const float scale = length > 0 ? 1 / length : 0;
  return {a[0] * scale, a[1] * scale, a[2] * scale};
}

}  // namespace

void Reconstructor::update(const Asset& asset) {
  tiles_.update(asset);
  detail_.update(asset);
}

void Reconstructor::run(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N, std::uint32_t first,
                        bool with_detail) const {
  if (first >= N) return;
  assert(N <= tiles_.rows() && rank <= tiles_.rank());
  const Packed base(tiles_, poses, rank);
  std::vector<Packed> derivatives;
  if (with_detail) {
    derivatives.emplace_back(detail_.along_x(), poses, rank);
    derivatives.emplace_back(detail_.along_y(), poses, rank);
  }
  const kernel::Functions& functions = kernel::functions(set_);
  const auto rebuild_tiles = [&](std::size_t first_tile, std::size_t end_row) {
    const std::size_t row = first_tile * kernel::kTileRows, rows = end_row - row;
    std::vector<std::span<float>> rooms;
    for (const PoseToRebuild& pose : poses) rooms.push_back(part_of(pose.positions, row, rows));
    base.multiply(functions, first_tile, rows, rooms);
    if (!with_detail) return;
    std::vector<float> along(2 * poses.size() * 3 * rows);
    const auto room = [&](std::size_t axis, std::size_t p) {
      return part_of(along, (axis * poses.size() + p) * rows, rows);
    };
    for (std::size_t axis = 0; axis < 2; ++axis) {
      for (std::size_t p = 0; p < poses.size(); ++p) rooms[p] = room(axis, p);
      derivatives[axis].multiply(functions, first_tile, rows, rooms);
    }
    for (std::size_t p = 0; p < poses.size(); ++p) {
      detail_.add(static_cast<std::uint32_t>(row), room(0, p), room(1, p), part_of(poses[p].positions, row, rows),
                  part_of(poses[p].normals, row, rows));
    }
  };
  const std::size_t begin = first / kernel::kTileRows;
  const std::size_t rows = N - begin * kernel::kTileRows;
  constexpr std::size_t kRows = kTilesPerTask * kernel::kTileRows;
  const std::size_t tasks = (rows + kRows - 1) / kRows;
  const auto do_task = [&](std::size_t task) {
    const std::size_t tile = begin + task * kTilesPerTask;
    rebuild_tiles(tile, std::min<std::size_t>(N, tile * kernel::kTileRows + kRows));
  };
  const std::size_t multiplications = rows * rank * 3 * poses.size() * (with_detail ? 3 : 1);
  const bool alone = threads_ == 1 || multiplications < kWorthThreadsToRebuild;
  if (alone && !with_detail) {
    rebuild_tiles(begin, N);
  } else if (alone) {
    for (std::size_t task = 0; task < tasks; ++task) do_task(task);
  } else {
    worker_team().run(tasks, do_task);
  }
}

void Reconstructor::rebuild(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N,
                            std::uint32_t first) const {
  run(poses, rank, N, first, has_detail());
}

void Reconstructor::rebuild(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
                            std::span<float> positions) const {
  const PoseToRebuild pose{C, channels, positions};
  rebuild({&pose, 1}, rank, N);
}

void Reconstructor::combine(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
                            std::span<float> values) const {
  const PoseToRebuild pose{C, channels, values};
  run({&pose, 1}, rank, N, 0, false);
}

void positions_from_coefficients(const Asset& asset, std::span<const double> C, std::uint32_t channels,
                                 std::uint32_t rank, std::uint32_t N, std::span<float> positions) {
  assert(N <= asset.rows_ready);
  Reconstructor once;
  once.update(asset);
  once.combine(C, channels, rank, N, positions);
}

std::vector<std::uint32_t> triangles_at_level(const Asset& asset, std::uint32_t N) {
  assert(asset.base_count <= N && N <= asset.rows_ready);
  const auto known = asset.death.begin() + asset.faces_ready;
  const auto alive = static_cast<std::size_t>(std::lower_bound(asset.death.begin(), known, N) - asset.death.begin());
  std::vector<std::uint32_t> triangles(alive * 3);
  for (std::size_t f = 0; f < alive; ++f) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      std::uint32_t a = asset.faces[f][corner];
      while (a >= N) a = asset.map[a];
      triangles[3 * f + corner] = a;
    }
  }
  return triangles;
}

namespace {

///   origin  of the number of a normal: its vertex
///   sum     its place
template <typename Origin, typename Sum>
void add_face_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles, const Origin& origin,
                      const Sum& sum) {
  for (std::size_t t = 0; t + 3 <= triangles.size(); t += 3) {
    const auto corners = triangles.subspan(t, 3);
    const Vector a = point(positions, origin(corners[0]));
    const Vector normal =
        cross(minus(point(positions, origin(corners[1])), a), minus(point(positions, origin(corners[2])), a));
    for (const std::uint32_t corner : corners) {
      float* const to = sum(corner);
      for (std::size_t d = 0; d < 3; ++d) to[d] += normal[d];
    }
  }
}

}  // namespace

void area_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles, std::span<float> sums) {
  assert(sums.size() >= positions.size());
  std::fill_n(sums.begin(), positions.size(), 0.0F);
  add_face_normals(
      positions, triangles, [](std::uint32_t corner) { return corner; },
      [&](std::uint32_t corner) { return &sums[std::size_t{3} * corner]; });
}

void area_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles,
                  const CornerNormals& corners, std::span<float> sums, std::span<float> extras) {
  assert(sums.size() >= positions.size());
  std::fill_n(sums.begin(), positions.size(), 0.0F);
  std::fill(extras.begin(), extras.end(), 0.0F);
  const std::uint32_t n = corners.vertices();
  add_face_normals(
      positions, triangles, [&](std::uint32_t normal) { return corners.origin(normal); },
      [&](std::uint32_t normal) {
        return normal < n ? &sums[std::size_t{3} * normal] : &extras[std::size_t{3} * (normal - n)];
      });
}

void normalise(std::span<float> vectors) {
  for (std::size_t i = 0; i + 3 <= vectors.size(); i += 3) {
    // In double: the square of a small face's area underflows in float.
    const double x = vectors[i], y = vectors[i + 1], z = vectors[i + 2];
    const double length = std::sqrt(x * x + y * y + z * z);
    const double scale = length > 0 ? 1 / length : 0;
    for (float& value : vectors.subspan(i, 3)) value = static_cast<float>(value * scale);
  }
}

void vertex_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles,
                    std::span<float> normals) {
  area_normals(positions, triangles, normals);
  normalise(normals.first(positions.size()));
}

void splat_normals(const Asset& asset, std::span<const float> positions, std::span<float> normals) {
  const std::size_t N = positions.size() / 3;
  assert(normals.size() >= positions.size());
  if (asset.splats.size() < N) {
    std::fill_n(normals.begin(), positions.size(), 0.0F);
    return;
  }
  for (std::size_t i = 0; i < N; ++i) {
    const auto& [first, second] = asset.splats.frame[i];
    const Vector here = point(positions, i);
    const Vector t = unit(minus(point(positions, first), here));
    const Vector m = unit(cross(t, minus(point(positions, second), here)));
    DetailFrame<float> frame;
    if (m != Vector{}) frame = {t, cross(m, t), m};
    const Vector normal = frame.from_frame(asset.splats.normal[i]);
    std::copy(normal.begin(), normal.end(), &normals[3 * i]);
  }
}

void splat_radii(const Asset& asset, std::uint32_t N, std::span<float> radii) {
  assert(asset.base_count <= N && N <= asset.rows_ready && radii.size() >= N);
  const Asset::Splats& splats = asset.splats;
  if (splats.size() < N) {
    std::fill_n(radii.begin(), N, 0.0F);
    return;
  }
  std::copy_n(splats.radius.begin(), N, radii.begin());
  for (std::uint32_t i = asset.base_count; i < N; ++i) radii[asset.map[i]] = splats.parent_radius[i];
}

std::uint32_t level_from_fraction(const Asset& asset, double fraction) {
  const double share = fraction > 0 ? std::min(fraction, 1.0) : 0.0;  // Also where it is not a number.
  const auto wanted = static_cast<std::uint32_t>(std::lround(share * asset.vertex_count));
  return std::min(std::max(wanted, asset.base_count), asset.rows_ready);
}

}  // namespace eigencast
