// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <queue>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/vector.h"

namespace eigencast::progressive {

/// Marks a contraction of a vertex that no face shows any more: its target is chosen at the end.
inline constexpr std::uint32_t kNoTarget = 0xffffffff;

/// One contraction, in source numbers.
struct Step {
  std::uint32_t from = 0;
  std::uint32_t to = 0;  ///< kNoTarget: any vertex will do.
};

/// Contractions of a mesh in order, at least cost over all poses, of which the first, the rest pose, says what hangs
/// together. No face has a repeated corner; positions are finite and of unit size. `seams`: edges (the lower vertex
/// first; ascending) that hold their line as boundaries do. Ends early once it is unwanted.
std::vector<Step> contract_mesh(std::span<const std::vector<Vec3>> poses, std::span<const Face> faces,
                                std::span<const std::pair<std::uint32_t, std::uint32_t>> seams,
                                const std::atomic<bool>& unwanted);

/// The same of a point cloud.
std::vector<Step> contract_points(std::span<const Vec3> positions, const std::atomic<bool>& unwanted);

/// The first vertex, in order of number, at each vertex's position (to the bit; itself if there is none before it).
std::vector<std::uint32_t> first_at_position(std::span<const Vec3> positions);

/// The sum of w (n . x + d)^2 over planes, as a symmetric 4 x 4 matrix (Garland & Heckbert 1997), and its area.
struct Quadric {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;  ///< sum of w n n^T
  double x = 0, y = 0, z = 0;                             ///< sum of w d n
  double constant = 0;                                    ///< sum of w d^2
  double area = 0;

  /// Adds the plane through p with unit normal n and weight w. Does not touch the area.
  void add_plane(const Vec3& n, const Vec3& p, double w) {
    const double d = -dot(n, p);
    xx += w * n[0] * n[0], xy += w * n[0] * n[1], xz += w * n[0] * n[2];
    yy += w * n[1] * n[1], yz += w * n[1] * n[2], zz += w * n[2] * n[2];
    x += w * d * n[0], y += w * d * n[1], z += w * d * n[2];
    constant += w * d * d;
  }

  /// Adds w |x - p|^2, the squared distance from a point. Does not touch the area.
  void add_point(const Vec3& p, double w) {
    xx += w, yy += w, zz += w;
    x -= w * p[0], y -= w * p[1], z -= w * p[2];
    constant += w * dot(p, p);
  }

  Quadric& operator+=(const Quadric& q) {
    xx += q.xx, xy += q.xy, xz += q.xz, yy += q.yy, yz += q.yz, zz += q.zz;
    x += q.x, y += q.y, z += q.z;
    constant += q.constant, area += q.area;
    return *this;
  }

  double at(const Vec3& p) const {
    return p[0] * (xx * p[0] + 2 * (xy * p[1] + xz * p[2] + x)) + p[1] * (yy * p[1] + 2 * (yz * p[2] + y)) +
           p[2] * (zz * p[2] + 2 * z) + constant;
  }
};

/// What moving `from` onto `to` costs, with the two quadrics there. The second term keeps flat regions sampled, which
/// the rest pose alone would empty although they may bend in other poses; it also decides between equal costs.
inline double contraction_cost(const Quadric& from, const Quadric& to, const Vec3& x_from, const Vec3& x_to) {
  constexpr double kDensity = 1e-3;
  const double error = from.at(x_to) + to.at(x_to);
  return (error > 0 ? error : 0) + kDensity * from.area * squared_distance(x_from, x_to);
}

/// A contraction that may be made next; a std::priority_queue of them has the cheapest on top, numbers decide between
/// equals.
struct Candidate {
  double cost;
  std::uint32_t from, to, version;
  bool operator<(const Candidate& other) const { return cost != other.cost ? cost > other.cost : from > other.from; }
};

/// The vertices that are left, and the queue of their contractions. A vertex's latest candidate replaces earlier ones.
class Contraction {
 protected:
  Contraction(std::size_t vertices, const std::atomic<bool>& unwanted)
      : unwanted_(unwanted), version_(vertices), alive_(vertices, true), alive_count_(vertices) {
    steps_.reserve(vertices);
  }

  void remove(std::uint32_t u, std::uint32_t to) {
    steps_.push_back({u, to});
    alive_[u] = false;
    --alive_count_;
  }
  /// How far to go from here.
  std::size_t wanted_base() const { return std::max<std::size_t>(4, alive_count_ / 100); }
  /// Calls make(candidate) for the cheapest ones until `goal` vertices are left or none is.
  template <typename Make>
  void contract_queue(std::size_t goal, const Make& make) {
    while (alive_count_ > goal && !queue_.empty() && !unwanted_) {
      const Candidate top = queue_.top();
      queue_.pop();
      if (alive_[top.from] && top.version == version_[top.from]) make(top);
    }
  }

  const std::atomic<bool>& unwanted_;
  std::vector<std::uint32_t> version_;
  std::vector<bool> alive_;
  std::size_t alive_count_;
  std::vector<Step> steps_;
  std::priority_queue<Candidate> queue_;
};

}  // namespace eigencast::progressive
