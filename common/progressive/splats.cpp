// SPDX-License-Identifier: MIT
#include "common/progressive/splats.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "common/progressive/contraction.h"
#include "common/progressive/limb.h"
#include "common/progressive/neighbours.h"

namespace eigencast {
namespace progressive {
namespace {

constexpr std::uint32_t kFinestFrame = 16384;  // later rows are not corners of frames
constexpr std::size_t kNearest = 8;            // rows that are tried as corners
constexpr std::size_t kCandidates = 48;
constexpr std::size_t kRadiusNeighbours = 6;
constexpr double kSameWay = 0.3;  // cosine between normals of discs that one may stand for
constexpr double kShrink = 0.92;
constexpr double kOfGap = 0.6;   // of the distance to the next points on two sides, likewise
constexpr double kLongest = 3;   // of the radius without gaps
constexpr double kRadius = 0.8;  // of the mean distance of the nearest points: discs overlap on an uneven surface, too

class SplatBuilder {
 public:
  SplatBuilder(std::span<const Vec3> positions, std::span<const Vec3> normals, const PrefixOrder& order)
      : order_(order), n_(order.order.size()) {
    x_.reserve(n_);
    normals_.reserve(n_);
    for (const std::uint32_t i : order.order) {
      x_.push_back(positions[i]);
      normals_.push_back(normals[i]);
    }
  }

  PointSplats run() {
    make_frames();
    make_radii();
    return std::move(result_);
  }

 private:
  void make_frames() {
    std::vector<std::uint32_t> base(order_.base_count);
    std::iota(base.begin(), base.end(), 0U);
    const Neighbours neighbours(x_, base);
    children_.resize(n_);
    for (std::uint32_t i = order_.base_count; i < std::min<std::size_t>(n_, kFinestFrame); ++i) {
      children_[order_.map[i]].push_back(i);
    }
    result_.frame.resize(n_);
    result_.normal.resize(n_);
    for (std::uint32_t i = 0; i < n_; ++i) {
      result_.frame[i] =
          best_frame(i, i < order_.base_count ? neighbours.nearest(x_[i], kCandidates) : forebears_of(i));
      const auto [a, b] = result_.frame[i];
      const auto axes = frame_from_points(x_[i], x_[a], x_[b]);
      for (std::size_t k = 0; k < 3; ++k) result_.normal[i][k] = static_cast<float>(dot(axes[k], normals_[i]));
    }
  }

  /// The rows about a row that came before it, by way of the tree that contraction makes. REQUIRES: row >= base_count.
  std::vector<std::uint32_t> forebears_of(std::uint32_t row) const {
    std::vector<std::uint32_t> found;
    const std::uint32_t end = std::min(row, kFinestFrame);
    const auto add = [&](std::uint32_t i) {
      if (i < end && found.size() < kCandidates && std::find(found.begin(), found.end(), i) == found.end()) {
        found.push_back(i);
      }
    };
    add(prefix_corner(order_.map, row, std::max(end, order_.base_count)));
    for (std::size_t at = 0; at < found.size() && found.size() < kCandidates; ++at) {
      for (const std::uint32_t i : result_.frame[found[at]]) add(i);
      for (const std::uint32_t i : children_[found[at]]) add(i);
    }
    return found;
  }

  /// The nearest pair of candidates that lie in different directions within the surface; ordered so that the frame's
  /// third vector is on the normal's side.
  std::array<std::uint32_t, 2> best_frame(std::uint32_t i, std::vector<std::uint32_t> candidates) const {
    std::erase_if(candidates, [&](std::uint32_t j) { return x_[j] == x_[i]; });
    std::sort(candidates.begin(), candidates.end(), [&](std::uint32_t a, std::uint32_t b) {
      const double to_a = length(x_[a] - x_[i]), to_b = length(x_[b] - x_[i]);
      return to_a != to_b ? to_a < to_b : a < b;
    });
    candidates.resize(std::min(candidates.size(), kNearest));
    std::array<std::uint32_t, 2> best{i, i};
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t a = 1; a < candidates.size(); ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        const Vec3 u = x_[candidates[a]] - x_[i], v = x_[candidates[b]] - x_[i];
        const double upright = dot(cross(u, v), normals_[i]);  // |u| |v| sin(u, v) cos(tilt)
        const double cost = (length(u) + length(v)) * length(u) * length(v) / std::abs(upright);
        if (!(cost < least)) continue;
        least = cost;
        best = upright > 0 ? std::array{candidates[a], candidates[b]} : std::array{candidates[b], candidates[a]};
      }
    }
    return best;
  }

  /// A disc's radius, at most `reach`, of which no two opposite ends lie in the air: else it is wider than its limb.
  /// Over a rim none reaches far, but for half of its radius, without which the rim would have holes.
  double within_limb(std::uint32_t i, double reach, double least, const Neighbours& neighbours) const {
    if (i >= kFinestFrame) return reach;
    const DiscOnLimb disc(x_[i], normals_[i], neighbours);
    while (reach > least && disc.is_wider(reach)) reach *= kShrink;
    const double least_at_rim = std::max(least, reach / 2);
    while (reach > least_at_rim && disc.is_over_rim(reach)) reach *= kShrink;
    return std::max(reach, least);
  }

  /// A disc reaches, within its plane, to the far side of the discs that it stands for and that look the same way, as
  /// far as its limb is wide.
  void make_radii() {
    const std::vector<std::uint32_t> first = first_at_position(x_);
    std::vector<std::uint32_t> distinct;
    for (std::uint32_t i = 0; i < n_; ++i) {
      if (first[i] == i) distinct.push_back(i);
    }
    const Neighbours neighbours(x_, distinct);
    std::vector<double> alone(n_);
    for (std::uint32_t i = 0; i < n_; ++i) {
      double sum = 0;
      const auto around = neighbours.nearest(x_[i], kRadiusNeighbours + 1);
      for (const std::uint32_t j : around) sum += length(x_[j] - x_[i]);
      alone[i] = around.size() > 1 ? kRadius * sum / static_cast<double>(around.size() - 1) : 0;
      const double gap = DiscOnLimb(x_[i], normals_[i], neighbours).gap();
      alone[i] = std::max(alone[i], std::min(kOfGap * gap, kLongest * alone[i]));
    }
    std::vector<std::vector<std::uint32_t>> stands_for(n_);
    for (std::uint32_t i = 0; i < n_; ++i) stands_for[i] = {i};
    std::vector<double> now = alone;
    const auto radius = [&](std::uint32_t i) {
      return static_cast<float>(within_limb(i, now[i], alone[i], neighbours));
    };
    result_.radius.resize(n_);
    result_.parent_radius.resize(n_);
    for (auto i = static_cast<std::uint32_t>(n_); i-- > order_.base_count;) {
      const std::uint32_t onto = order_.map[i];
      result_.radius[i] = radius(i);
      result_.parent_radius[i] = radius(onto);
      for (const std::uint32_t j : stands_for[i]) {
        if (dot(normals_[j], normals_[onto]) < kSameWay) continue;
        const Vec3 e = x_[j] - x_[onto];
        const double above = dot(e, normals_[onto]);
        now[onto] = std::max(now[onto], std::sqrt(std::max(0.0, dot(e, e) - above * above)) + alone[j] / 2);
      }
      if (stands_for[onto].size() < stands_for[i].size()) std::swap(stands_for[onto], stands_for[i]);
      stands_for[onto].insert(stands_for[onto].end(), stands_for[i].begin(), stands_for[i].end());
      stands_for[i] = {};
    }
    for (std::uint32_t i = 0; i < order_.base_count; ++i) result_.radius[i] = radius(i);
  }

  const PrefixOrder& order_;
  std::size_t n_;
  std::vector<Vec3> x_, normals_;  // by row
  std::vector<std::vector<std::uint32_t>> children_;
  PointSplats result_;
};

}  // namespace
}  // namespace progressive

std::array<Vec3, 3> frame_from_points(const Vec3& origin, const Vec3& first, const Vec3& second) {
  const Vec3 t = unit(first - origin), m = unit(cross(t, second - origin));
  if (!(length(m) > 0)) return {Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}};
  return {t, cross(m, t), m};
}

PointSplats build_splats(std::span<const Vec3> positions, std::span<const Vec3> normals, const PrefixOrder& order) {
  assert(positions.size() == order.order.size() && normals.size() == positions.size());
  return progressive::SplatBuilder(positions, normals, order).run();
}

}  // namespace eigencast
