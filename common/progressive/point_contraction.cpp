// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "common/progressive/contraction.h"
#include "common/progressive/limb.h"
#include "common/progressive/neighbours.h"
#include "common/progressive/point_normals.h"

namespace eigencast::progressive {
namespace {

constexpr std::size_t kLinks = 10;
constexpr std::size_t kMaxLinks = 2 * kLinks;
constexpr std::size_t kFewestNeighbours = 4;  // Left to a point that others drop.

class PointContraction : Contraction {
 public:
  PointContraction(std::span<const Vec3> positions, const std::atomic<bool>& unwanted)
      : Contraction(positions.size(), unwanted),
        x_(positions),
        links_(positions.size()),
        quadrics_(positions.size()),
        width_(positions.size(), std::numeric_limits<double>::infinity()),
        reach_(positions.size()) {}

  std::vector<Step> run() {
    const auto first = first_at_position(x_);
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      if (first[v] != v) remove(v, first[v]);
    }
    const std::size_t goal = wanted_base();
    bool has_quadrics = false;
    // Far groups of points have no links between them: linked anew when each of them is one point.
    while (alive_count_ > goal && !unwanted_) {
      link_neighbours();
      if (!std::exchange(has_quadrics, true)) make_quadrics();
      queue_ = {};
      for (std::uint32_t v = 0; v < x_.size(); ++v) {
        if (alive_[v]) consider(v);
      }
      contract_queue(goal, [this](const Candidate& next) { contract(next.from, next.to); });
    }
    return std::move(steps_);
  }

 private:
  void link_neighbours() {
    std::vector<std::uint32_t> members;
    for (std::uint32_t v = 0; v < x_.size(); ++v) {
      links_[v].clear();
      if (alive_[v]) members.push_back(v);
    }
    const Neighbours neighbours(x_, members);
    for (const std::uint32_t v : members) {
      for (const std::uint32_t w : neighbours.nearest(x_[v], kLinks + 1)) {
        if (w == v) continue;
        links_[v].push_back(w);
        links_[w].push_back(v);
      }
    }
    for (const std::uint32_t v : members) {
      std::sort(links_[v].begin(), links_[v].end());
      links_[v].erase(std::unique(links_[v].begin(), links_[v].end()), links_[v].end());
    }
  }

  // Planes through p that hold the direction across e = p - p_i within the tangent plane (Pauly, Gross, Kobbelt 2002,
  // "Efficient simplification of point-sampled surfaces"), and p itself, weighed as they are: planes alone let a point
  // represent a long piece of a limb, as a disc that is as long, and wider than the limb.
  void make_quadrics() {
    const auto first = first_at_position(x_);
    std::vector<std::uint32_t> distinct;
    for (std::uint32_t p = 0; p < x_.size(); ++p) {
      if (first[p] == p) distinct.push_back(p);
    }
    const Neighbours neighbours(x_, std::move(distinct));
    for (std::uint32_t p = 0; p < x_.size() && !unwanted_; ++p) {
      if (!alive_[p] || links_[p].empty()) continue;
      const Vec3 n = normal_from_points(x_, x_[p], links_[p]);
      double nearest = squared_distance(x_[p], x_[links_[p].front()]);
      for (const std::uint32_t i : links_[p]) nearest = std::min(nearest, squared_distance(x_[p], x_[i]));
      width_[p] = width_of_limb(p, n, neighbours);
      quadrics_[p].area = nearest;
      quadrics_[p].add_point(x_[p], nearest);
      for (const std::uint32_t i : links_[p]) {
        const Vec3 e = x_[p] - x_[i];
        const Vec3 normal = cross(e, cross(e, n));
        if (length(normal) > 0)
          quadrics_[p].add_plane(unit(normal), x_[p], nearest / static_cast<double>(links_[p].size()));
      }
    }
  }

  /// How long a piece of its limb a point may stand for: what a disc covers that is not wider. Elsewhere any.
  double width_of_limb(std::uint32_t p, const Vec3& n, const Neighbours& neighbours) const {
    constexpr double kWidest = 16, kWider = 1.3;  // discs that are tried, in distances of points; a step
    constexpr double kLength = 1.5;               // of a disc's radius
    constexpr std::array kDepths{1.5, 0.6};       // likewise, to where the far side may be
    const DiscOnLimb disc(x_[p], n, neighbours);
    const double least = disc.gap();
    double radius = kWider * least;
    while (radius < kWidest * least && !disc.is_wider(radius)) radius *= kWider;
    const auto is_far_side = [&](double depth) {
      const Vec3 behind = x_[p] + depth * n;
      return length(x_[neighbours.nearest(behind, 1).front()] - behind) < 0.5 * std::abs(depth);
    };
    const bool is_limb = radius < kWidest * least && std::any_of(kDepths.begin(), kDepths.end(), [&](double of) {
                           return is_far_side(of * radius) || is_far_side(-of * radius);
                         });
    return is_limb ? kLength * radius / kWider : std::numeric_limits<double>::infinity();
  }

  /// Discs are round: where a point stands for a longer piece of a limb than it is wide, the limb has gaps.
  double cost_of_gaps(std::uint32_t u, std::uint32_t v) const {
    const double over = reach_with(u, v) / width_[v];
    return over > 1 ? over * over * over * over : 1;
  }
  double reach_with(std::uint32_t u, std::uint32_t v) const {
    return std::sqrt(squared_distance(x_[u], x_[v])) + reach_[u];
  }

  void consider(std::uint32_t u) {
    ++version_[u];
    if (links_[u].empty()) return;
    Candidate best{0, u, u, version_[u]};
    for (const std::uint32_t v : links_[u]) {
      const double cost = cost_of_gaps(u, v) * contraction_cost(quadrics_[u], quadrics_[v], x_[u], x_[v]);
      if (best.to == u || cost < best.cost || (cost == best.cost && v < best.to)) {
        best.cost = cost;
        best.to = v;
      }
    }
    queue_.push(best);
  }

  void contract(std::uint32_t u, std::uint32_t v) {
    remove(u, v);
    quadrics_[v] += quadrics_[u];
    reach_[v] = std::max(reach_[v], reach_with(u, v));
    const std::vector<std::uint32_t> moved = std::move(links_[u]);
    links_[u].clear();
    for (const std::uint32_t w : moved) {
      std::erase(links_[w], u);
      if (w == v || std::find(links_[v].begin(), links_[v].end(), w) != links_[v].end()) continue;
      links_[v].push_back(w);
      links_[w].push_back(v);
    }
    std::vector<std::uint32_t> changed = links_[v];
    trim(v);
    consider(v);
    for (const std::uint32_t w : changed) consider(w);
  }

  void trim(std::uint32_t v) {
    auto& links = links_[v];
    if (links.size() <= kMaxLinks) return;
    std::sort(links.begin(), links.end(), [&](std::uint32_t a, std::uint32_t b) {
      const double to_a = squared_distance(x_[v], x_[a]), to_b = squared_distance(x_[v], x_[b]);
      return to_a != to_b ? to_a < to_b : a < b;
    });
    for (std::size_t i = links.size(); i-- > kMaxLinks;) {
      auto& back = links_[links[i]];
      if (back.size() <= kFewestNeighbours) continue;
      std::erase(back, v);
      links.erase(links.begin() + static_cast<std::ptrdiff_t>(i));
    }
  }

  std::span<const Vec3> x_;
  std::vector<std::vector<std::uint32_t>> links_;  ///< Symmetric: a point links to those that link to it.
  std::vector<Quadric> quadrics_;
  std::vector<double> width_, reach_;  ///< See width_of_limb(); to the farthest point stood for, at most.
};

}  // namespace

std::vector<Step> contract_points(std::span<const Vec3> positions, const std::atomic<bool>& unwanted) {
  return PointContraction(positions, unwanted).run();
}

}  // namespace eigencast::progressive
