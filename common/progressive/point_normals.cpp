// SPDX-License-Identifier: MIT
#include "common/progressive/point_normals.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>

#include "common/core/histogram.h"
#include "common/core/worker_team.h"
#include "common/progressive/contraction.h"
#include "common/progressive/neighbours.h"

namespace eigencast {
namespace progressive {

Vec3 normal_from_points(std::span<const Vec3> positions, const Vec3& centre, std::span<const std::uint32_t> around) {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  Vec3 mean = centre;
  for (const std::uint32_t i : around) mean = mean + positions[i];
  for (double& value : mean) value /= static_cast<double>(around.size() + 1);
  const auto add = [&](const Vec3& p) {
    const Vec3 e = p - mean;
    xx += e[0] * e[0], xy += e[0] * e[1], xz += e[0] * e[2], yy += e[1] * e[1], yz += e[1] * e[2], zz += e[2] * e[2];
  };
  add(centre);
  for (const std::uint32_t i : around) add(positions[i]);
  const double trace = xx + yy + zz;
  Vec3 n{0.48, 0.6, 0.64};
  if (trace <= 0) return n;
  for (int round = 0; round < 32; ++round) {
    const Vec3 next{trace * n[0] - (xx * n[0] + xy * n[1] + xz * n[2]),
                    trace * n[1] - (xy * n[0] + yy * n[1] + yz * n[2]),
                    trace * n[2] - (xz * n[0] + yz * n[1] + zz * n[2])};
    if (length(next) <= 0) break;
    n = unit(next);
  }
  return n;
}

namespace {

constexpr std::size_t kNormalNeighbours = 16;  // that a normal is made from
constexpr std::size_t kEdges = 10;             // of a point, along which its sign may be carried
constexpr double kUp = 1e-3;                   // weight of "upwards" beside "outwards"
constexpr double kManyVotes = 30;  // of a set: about those of two points that are seen from half of all sides
constexpr double kClear = 0.15;    // share of a set's votes by which one side must lead to decide
constexpr double kReach = 1.0;     // radius of a disc that hides, of the mean distance to a point's neighbours
constexpr std::size_t kPointsAtOnce = 1024;  // for a thread
constexpr double kGrazing = 0.25;      // |n . d| below which a disc is too thin to draw, and seeing it says nothing
constexpr double kPixelsInRadius = 2;  // of a typical disc
constexpr double kMaxPixels = 4096;    // across the picture
constexpr double kMaxRadius = 24;      // pixels of one disc: a lone point hides no more
constexpr double kInFront = 0.4;       // radii by which another disc must lie before a point to hide it

/// Says on which side of a point the outside lies, as far as it can be seen from there.
struct SideVote {
  double along = 0;  ///< Sum of n . d over the directions d from which the point is seen.
  double all = 0;    ///< Sum of |n . d| over the same.
};

/// Directions spread evenly over the sphere, along a spiral of the golden angle.
std::array<Vec3, 64> all_round() {
  std::array<Vec3, 64> directions{};
  for (std::size_t k = 0; k < directions.size(); ++k) {
    const double y = 1 - (2 * static_cast<double>(k) + 1) / static_cast<double>(directions.size());
    const double angle = 2.399963229728653 * static_cast<double>(k);
    const double r = std::sqrt(1 - y * y);
    directions[k] = {r * std::cos(angle), y, r * std::sin(angle)};
  }
  return directions;
}

/// Pictures of the points, one direction at a time. Its buffer is kept from one to the next.
class Camera {
 public:
  Camera(std::span<const Vec3> positions, std::span<const Vec3> normals, std::span<const double> radii, double pixel)
      : x_(positions), n_(normals), r_(radii), pixel_(pixel) {}

  /// Calls seen(i) for each point that is seen from `direction`.
  template <typename Seen>
  void for_each_seen(const Vec3& direction, const Seen& seen) {
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

/// Draws the points from 64 directions, each a disc across its normal, into a buffer of depths: what is seen of a
/// closed surface is seen from outside. Points deep inside a fold may be seen from nowhere; sheets are seen from both
/// sides. After Katz, Tal, Basri 2007, "Direct visibility of point sets", in its aim, not in its means. Normals have
/// any sign; points of radius 0 neither hide nor vote. The votes do not depend on the threads, up to 64 MB each.
std::vector<SideVote> side_votes(std::span<const Vec3> positions, std::span<const Vec3> normals,
                                 std::span<const double> radii) {
  std::vector<SideVote> votes(positions.size());
  std::vector<double> positive;
  std::copy_if(radii.begin(), radii.end(), std::back_inserter(positive), [](double radius) { return radius > 0; });
  if (positive.empty()) return votes;
  const double pixel =
      std::max(median(std::move(positive)) / kPixelsInRadius, bounding_box(positions).diagonal() / kMaxPixels);
  if (!(pixel > 0)) return votes;
  const auto directions = all_round();
  std::vector<std::uint64_t> seen(positions.size());  // a bit for each direction
  const std::size_t parts = worker_team().threads();
  worker_team().run(parts, [&](std::size_t part) {
    Camera camera(positions, normals, radii, pixel);
    for (std::size_t k = part; k < directions.size(); k += parts) {
      camera.for_each_seen(directions[k], [&](std::size_t i) {
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

/// Sets of points whose normals' signs are known relative to each other, with what has been seen of them: a vote counts
/// for the normal of the set's root.
class SignedSets {
 public:
  explicit SignedSets(std::vector<SideVote> votes)
      : parent_(votes.size()), flipped_(votes.size(), 0), votes_(std::move(votes)) {
    std::iota(parent_.begin(), parent_.end(), 0U);
  }

  struct Root {
    std::uint32_t root;
    bool flipped;  // the point against its root
  };
  Root find(std::uint32_t i) {
    bool flipped = false;
    std::uint32_t root = i;
    for (; parent_[root] != root; root = parent_[root]) flipped ^= flipped_[root] != 0;
    for (bool rest = flipped; parent_[i] != root && i != root;) {
      const std::uint32_t next = parent_[i];
      const bool here = flipped_[i] != 0;
      parent_[i] = root;
      flipped_[i] = rest ? 1 : 0;
      rest ^= here;
      i = next;
    }
    return {root, flipped};
  }
  /// Makes one set of two, unless what has been seen of both says that the edge carries the sign wrongly.
  void join(std::uint32_t a, std::uint32_t b, bool opposite) {
    const Root x = find(a), y = find(b);
    if (x.root == y.root) return;
    const bool against = x.flipped ^ y.flipped ^ opposite;
    SideVote &first = votes_[std::min(x.root, y.root)], &second = votes_[std::max(x.root, y.root)];
    const double added = against ? -second.along : second.along;
    if (is_clear(first) && is_clear(second) && (first.along > 0) != (added > 0)) return;
    parent_[std::max(x.root, y.root)] = std::min(x.root, y.root);
    flipped_[std::max(x.root, y.root)] = against ? 1 : 0;
    first.along += added;
    first.all += second.all;
  }

  /// Whether a root's outward side is known.
  bool decided(std::uint32_t root) const { return is_clear(votes_[root]); }
  bool looks_inwards(std::uint32_t root) const { return votes_[root].along < 0; }

 private:
  static bool is_clear(const SideVote& vote) {
    return vote.all >= kManyVotes && std::abs(vote.along) >= kClear * vote.all;
  }

  std::vector<std::uint32_t> parent_;
  std::vector<char> flipped_;
  std::vector<SideVote> votes_;
};

struct Edge {
  double doubt;  // 0: the mirrored normal is the other's, up to its sign; 1: across it
  std::uint32_t from, to;
  bool opposite;
};

Edge edge_between(std::span<const Vec3> positions, std::span<const Vec3> normals, std::uint32_t a, std::uint32_t b) {
  const Vec3 e = positions[b] - positions[a];
  const double squared = dot(e, e), along = dot(normals[a], e);
  const double agreement = dot(normals[a], normals[b]) - (squared > 0 ? 2 * along * dot(normals[b], e) / squared : 0);
  return {1 - std::abs(agreement), std::min(a, b), std::max(a, b), agreement < 0};
}

/// Whether most normals at the set's outermost points point inwards; where that is even, as on a sheet, whether the
/// highest points down.
bool looks_inwards(std::span<const Vec3> positions, std::span<const Vec3> normals, std::span<const std::uint32_t> set) {
  double outwards = 0;
  const auto directions = all_round();
  for (const Vec3& direction : directions) {
    const auto outermost = *std::max_element(set.begin(), set.end(), [&](std::uint32_t a, std::uint32_t b) {
      return dot(direction, positions[a]) < dot(direction, positions[b]);
    });
    outwards += dot(direction, normals[outermost]);
    if (&direction == &directions.front()) outwards += kUp * normals[outermost][1];
  }
  return outwards < 0;
}

/// Turns each set as a whole: to the side from which it is seen, or, where that is not clear, outwards at its outermost
/// points.
void turn_outwards(std::span<const Vec3> positions, SignedSets& sets, std::vector<Vec3>& normals) {
  std::vector<std::vector<std::uint32_t>> members(positions.size());  // by root
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    const auto [root, flipped] = sets.find(i);
    members[root].push_back(i);
    if (flipped) normals[i] = -1 * normals[i];
  }
  for (std::uint32_t root = 0; root < members.size(); ++root) {
    const auto& set = members[root];
    if (set.empty()) continue;
    if (!(sets.decided(root) ? sets.looks_inwards(root) : looks_inwards(positions, normals, set))) continue;
    for (const std::uint32_t i : set) normals[i] = -1 * normals[i];
  }
}

}  // namespace
}  // namespace progressive

std::vector<Vec3> oriented_normals(std::span<const Vec3> positions) {
  using namespace progressive;
  const auto first = first_at_position(positions);
  std::vector<std::uint32_t> members;
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    if (first[i] == i) members.push_back(i);
  }
  std::vector<Vec3> normals(positions.size(), Vec3{0, 1, 0});
  if (members.size() < 3) return normals;
  const Neighbours neighbours(positions, members);
  std::vector<std::array<std::uint32_t, kEdges>> edges_of(members.size());
  std::vector<double> reach(positions.size());  // 0 for copies of a point, which neither hide nor vote
  for_each_shared(members.size(), kPointsAtOnce, [&](std::size_t m) {
    const std::uint32_t i = members[m];
    std::vector<std::uint32_t> around = neighbours.nearest(positions[i], kNormalNeighbours + 1);
    std::erase(around, i);
    normals[i] = normal_from_points(positions, positions[i], around);
    edges_of[m].fill(i);
    std::copy_n(around.begin(), std::min(kEdges, around.size()), edges_of[m].begin());
    for (const std::uint32_t j : edges_of[m]) reach[i] += length(positions[j] - positions[i]);
    reach[i] *= kReach / static_cast<double>(std::max<std::size_t>(1, std::min(kEdges, around.size())));
  });
  std::vector<Edge> edges;
  edges.reserve(members.size() * kEdges);
  for (std::size_t m = 0; m < members.size(); ++m) {
    for (const std::uint32_t j : edges_of[m]) {
      if (j != members[m]) edges.push_back(edge_between(positions, normals, members[m], j));
    }
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    return std::tie(a.doubt, a.from, a.to) < std::tie(b.doubt, b.from, b.to);
  });
  SignedSets sets(side_votes(positions, normals, reach));
  for (const Edge& edge : edges) sets.join(edge.from, edge.to, edge.opposite);
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    if (first[i] == i) continue;
    sets.join(i, first[i], false);
    normals[i] = normals[first[i]];
  }
  turn_outwards(positions, sets, normals);
  return normals;
}

}  // namespace eigencast
