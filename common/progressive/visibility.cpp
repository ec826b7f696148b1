// SPDX-License-Identifier: MIT
#include "common/progressive/visibility.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <tuple>

#include "common/core/worker_team.h"
#include "common/progressive/directions.h"
#include "common/surface/vector.h"

namespace eigencast::progressive {
namespace {

constexpr double kGrazing = 0.25;      // |n . d| below which a disc is too thin to draw and a look at it says nothing
constexpr double kPixelsInRadius = 2;  // of a typical disc
constexpr double kMaxPixels = 4096;    // across the picture
constexpr double kMaxRadius = 24;      // pixels of one disc: a lone point hides no more
constexpr double kInFront = 0.4;       // radii by which another disc must lie before a point to hide it

/// Pictures of the points, one direction at a time. Its buffer is kept from one to the next.
class Camera {
 public:
  Camera(std::span<const Vec3> positions, std::span<const Vec3> normals, std::span<const double> radii, double pixel)
      : x_(positions), n_(normals), r_(radii), pixel_(pixel) {}

  /// Calls seen(i) for each point that is seen from `direction`.
  template <typename Seen>
  void look(const Vec3& direction, const Seen& seen) {
    aim(direction);
    for (std::size_t i = 0; i < x_.size(); ++i) draw(i);
    for (std::size_t i = 0; i < x_.size(); ++i) {
      if (!(r_[i] > 0) || std::abs(dot(n_[i], d_)) < kGrazing) continue;
      const float front = depth_[row_of(i) * width_ + column_of(i)];
      if (static_cast<double>(front) <= dot(x_[i], d_) + kInFront * r_[i]) seen(i);
    }
  }

 private:
  void aim(const Vec3& direction) {
    d_ = direction;
    const Vec3 side = std::abs(d_[1]) < 0.9 ? Vec3{0, 1, 0} : Vec3{1, 0, 0};
    u_ = unit(cross(side, d_));
    v_ = cross(d_, u_);
    low_u_ = low_v_ = std::numeric_limits<double>::infinity();
    double high_u = -low_u_, high_v = -low_v_;
    for (const Vec3& p : x_) {
      low_u_ = std::min(low_u_, dot(p, u_)), high_u = std::max(high_u, dot(p, u_));
      low_v_ = std::min(low_v_, dot(p, v_)), high_v = std::max(high_v, dot(p, v_));
    }
    width_ = static_cast<std::size_t>((high_u - low_u_) / pixel_) + 1;
    height_ = static_cast<std::size_t>((high_v - low_v_) / pixel_) + 1;
    depth_.assign(width_ * height_, -std::numeric_limits<float>::infinity());
  }

  std::size_t column_of(std::size_t i) const { return static_cast<std::size_t>((dot(x_[i], u_) - low_u_) / pixel_); }
  std::size_t row_of(std::size_t i) const { return static_cast<std::size_t>((dot(x_[i], v_) - low_v_) / pixel_); }

  /// A disc seen from afar: an ellipse, whose depth is that of its plane.
  void draw(std::size_t i) {
    const double facing = dot(n_[i], d_);
    if (!(r_[i] > 0) || std::abs(facing) < kGrazing) return;
    const double nu = dot(n_[i], u_) / facing, nv = dot(n_[i], v_) / facing;
    const double at_u = (dot(x_[i], u_) - low_u_) / pixel_, at_v = (dot(x_[i], v_) - low_v_) / pixel_;
    const double depth = dot(x_[i], d_), radius = std::min(r_[i] / pixel_, kMaxRadius);
    const auto first = [&](double at) { return static_cast<std::size_t>(std::max(0.0, at - radius)); };
    const auto last = [&](double at, std::size_t size) {
      return std::min(size - 1, static_cast<std::size_t>(at + radius));
    };
    for (std::size_t row = first(at_v); row <= last(at_v, height_); ++row) {
      const double b = static_cast<double>(row) + 0.5 - at_v;
      for (std::size_t column = first(at_u); column <= last(at_u, width_); ++column) {
        const double a = static_cast<double>(column) + 0.5 - at_u;
        const double deeper = nu * a + nv * b;  // within the disc's plane
        if (a * a + b * b + deeper * deeper > radius * radius) continue;
        float& there = depth_[row * width_ + column];
        there = std::max(there, static_cast<float>(depth - deeper * pixel_));
      }
    }
  }

  std::span<const Vec3> x_, n_;
  std::span<const double> r_;
  double pixel_;
  Vec3 d_{}, u_{}, v_{};
  double low_u_ = 0, low_v_ = 0;
  std::size_t width_ = 0, height_ = 0;
  std::vector<float> depth_;  // along d_: the largest is in front
};

double pixel_for(std::span<const Vec3> positions, std::span<const double> radii) {
  std::vector<double> sorted;
  std::copy_if(radii.begin(), radii.end(), std::back_inserter(sorted), [](double radius) { return radius > 0; });
  if (sorted.empty()) return 0;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return std::max(*middle / kPixelsInRadius, bounding_box(positions).diagonal() / kMaxPixels);
}

}  // namespace

std::vector<SideVote> side_votes(std::span<const Vec3> positions, std::span<const Vec3> normals,
                                 std::span<const double> radii) {
  std::vector<SideVote> votes(positions.size());
  if (positions.empty()) return votes;
  const double pixel = pixel_for(positions, radii);
  if (!(pixel > 0)) return votes;
  const auto directions = all_round();
  static_assert(std::tuple_size_v<decltype(all_round())> <= 64);
  std::vector<std::uint64_t> seen(positions.size());  // a bit for each direction
  const std::size_t parts = worker_team().threads();
  worker_team().run(parts, [&](std::size_t part) {
    Camera camera(positions, normals, radii, pixel);
    for (std::size_t k = part; k < directions.size(); k += parts) {
      camera.look(directions[k], [&](std::size_t i) {
        std::atomic_ref(seen[i]).fetch_or(std::uint64_t{1} << k, std::memory_order_relaxed);
      });
    }
  });
  for (std::size_t i = 0; i < positions.size(); ++i) {
    for (std::size_t k = 0; k < directions.size(); ++k) {
      if ((seen[i] >> k & 1) == 0) continue;
      const double along = dot(normals[i], directions[k]);
      votes[i].along += along;
      votes[i].all += std::abs(along);
    }
  }
  return votes;
}

}  // namespace eigencast::progressive
