// SPDX-License-Identifier: MIT
#include "common/progressive/point_normals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

#include "common/core/worker_team.h"
#include "common/progressive/contraction.h"
#include "common/progressive/directions.h"
#include "common/progressive/neighbours.h"
#include "common/progressive/visibility.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace progressive {

Vec3 normal_from_points(std::span<const Vec3> positions, const Vec3& centre, std::span<const std::uint32_t> around) {
  double xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  Vec3 mean = centre;
  for (const std::uint32_t i : around) {
    for (std::size_t d = 0; d < 3; ++d) mean[d] += positions[i][d];
  }
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

  /// Of a root: whether its outward side is known.
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
  bool first = true;
  for (const Vec3& direction : all_round()) {
    const auto outermost = *std::max_element(set.begin(), set.end(), [&](std::uint32_t a, std::uint32_t b) {
      return dot(direction, positions[a]) < dot(direction, positions[b]);
    });
    outwards += dot(direction, normals[outermost]);
    if (std::exchange(first, false)) outwards += kUp * normals[outermost][1];
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
    if (!flipped) continue;
    for (double& x : normals[i]) x = -x;
  }
  for (std::uint32_t root = 0; root < members.size(); ++root) {
    const auto& set = members[root];
    if (set.empty()) continue;
    if (!(sets.decided(root) ? sets.looks_inwards(root) : looks_inwards(positions, normals, set))) continue;
    for (const std::uint32_t i : set) {
      for (double& x : normals[i]) x = -x;
    }
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
  worker_team().run((members.size() + kPointsAtOnce - 1) / kPointsAtOnce, [&](std::size_t part) {
    const std::size_t end = std::min(members.size(), (part + 1) * kPointsAtOnce);
    for (std::size_t m = part * kPointsAtOnce; m < end; ++m) {
      const std::uint32_t i = members[m];
      std::vector<std::uint32_t> around = neighbours.nearest(positions[i], kNormalNeighbours + 1);
      std::erase(around, i);
      normals[i] = normal_from_points(positions, positions[i], around);
      edges_of[m].fill(i);
      std::copy_n(around.begin(), std::min(kEdges, around.size()), edges_of[m].begin());
      for (const std::uint32_t j : edges_of[m]) reach[i] += length(positions[j] - positions[i]);
      reach[i] *= kReach / static_cast<double>(std::max<std::size_t>(1, std::min(kEdges, around.size())));
    }
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
