// SPDX-License-Identifier: MIT
#include "common/progressive/prefix.h"

#include <algorithm>
#include <cassert>
#include <numeric>

#include "common/progressive/contraction.h"
#include "common/progressive/neighbours.h"
#include "common/surface/edge_uses.h"

namespace eigencast {
namespace progressive {

std::vector<std::uint32_t> first_at_position(std::span<const Vec3> positions) {
  std::vector<std::uint32_t> sorted(positions.size()), first(positions.size());
  std::iota(sorted.begin(), sorted.end(), 0U);
  std::sort(sorted.begin(), sorted.end(), [&](std::uint32_t a, std::uint32_t b) {
    return positions[a] != positions[b] ? positions[a] < positions[b] : a < b;
  });
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    const bool same = i > 0 && positions[sorted[i]] == positions[sorted[i - 1]];
    first[sorted[i]] = same ? first[sorted[i - 1]] : sorted[i];
  }
  return first;
}

}  // namespace progressive

namespace {

using progressive::kNoTarget;
using progressive::Step;
constexpr std::uint32_t kMinBase = 4;

/// The rest pose within [-1, 1], so that thresholds mean the same for every model, and the others at its scale, each
/// about its own middle.
std::vector<std::vector<Vec3>> unit_poses(std::span<const Vec3> rest, std::span<const std::vector<Vec3>> others) {
  std::vector<std::vector<Vec3>> poses = {{rest.begin(), rest.end()}};
  poses.insert(poses.end(), others.begin(), others.end());
  double half = 0;
  for (std::vector<Vec3>& pose : poses) {
    assert(pose.size() == rest.size());
    const Box box = bounding_box(pose);
    // Halves first: the difference of two finite numbers may not be finite.
    if (half == 0) {
      for (std::size_t d = 0; d < 3; ++d) half = std::max(half, box.high[d] / 2 - box.low[d] / 2);
    }
    if (half <= 0) continue;
    for (Vec3& p : pose) {
      for (std::size_t d = 0; d < 3; ++d) p[d] = (p[d] - (box.low[d] / 2 + box.high[d] / 2)) / half;
    }
  }
  return poses;
}

/// Returns the new number of each vertex.
std::vector<std::uint32_t> order_vertices(std::vector<Step> steps, std::span<const Vec3> positions,
                                          PrefixOrder& prefix) {
  const auto n = static_cast<std::uint32_t>(positions.size());
  // Where nothing can be seen (all faces without area) every vertex would go; the last ones stay.
  steps.resize(std::min<std::size_t>(steps.size(), n - std::min(n, kMinBase)));
  prefix.base_count = n - static_cast<std::uint32_t>(steps.size());
  prefix.order.resize(n);
  std::vector<bool> in_base(n, true);
  for (std::size_t t = 0; t < steps.size(); ++t) {
    in_base[steps[t].from] = false;
    prefix.order[n - 1 - t] = steps[t].from;
  }
  std::vector<std::uint32_t> base;
  for (std::uint32_t v = 0; v < n; ++v) {
    if (in_base[v]) base.push_back(v);
  }
  std::copy(base.begin(), base.end(), prefix.order.begin());

  std::vector<std::uint32_t> new_from_source(n);
  for (std::uint32_t i = 0; i < n; ++i) new_from_source[prefix.order[i]] = i;
  const progressive::Neighbours neighbours(positions, base);
  prefix.map.resize(n);
  std::iota(prefix.map.begin(), prefix.map.end(), 0U);
  for (const Step& step : steps) {
    const std::uint32_t to = step.to == kNoTarget ? neighbours.nearest(positions[step.from], 1).front() : step.to;
    prefix.map[new_from_source[step.from]] = new_from_source[to];
    assert(new_from_source[to] < new_from_source[step.from]);
  }
  return new_from_source;
}

// The largest of the levels at which two corners of the face are one vertex; 0 if the base still has the face.
std::uint32_t death_of(std::span<const std::uint32_t> map, Face corners, std::uint32_t base_count) {
  while (true) {
    const std::uint32_t last = *std::max_element(corners.begin(), corners.end());
    if (last < base_count) return 0;
    *std::find(corners.begin(), corners.end(), last) = map[last];
    if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) return last;
  }
}

void order_faces(const Surface& surface, std::span<const std::uint32_t> new_from_source, PrefixOrder& prefix) {
  struct Entry {
    std::uint32_t death, source;
    Face corners;
  };
  std::vector<Entry> entries;
  entries.reserve(surface.faces.size());
  for (std::uint32_t f = 0; f < surface.faces.size(); ++f) {
    if (!has_three_corners(surface.faces[f], surface.vertex_count())) continue;
    Face corners;
    for (std::size_t c = 0; c < 3; ++c) corners[c] = new_from_source[surface.faces[f][c]];
    entries.push_back({death_of(prefix.map, corners, prefix.base_count), f, corners});
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return a.death != b.death ? a.death < b.death : a.source < b.source;
  });
  for (const Entry& entry : entries) {
    prefix.faces.push_back(entry.corners);
    prefix.death.push_back(entry.death);
    prefix.face_source.push_back(entry.source);
  }
}

}  // namespace

Result<PrefixOrder> build_prefix_order(const Surface& surface,
                                       std::span<const std::pair<std::uint32_t, std::uint32_t>> seams,
                                       std::span<const std::vector<Vec3>> others, const std::atomic<bool>& unwanted) {
  const std::size_t n = surface.positions.size();
  if (n == 0) return fail(ErrorCode::kInvalidArgument, "surface: no vertices, so there is nothing to order");
  if (n >= kNoTarget || surface.faces.size() >= kNoTarget) {
    return fail(ErrorCode::kTooLarge, "surface: more vertices or faces than 32-bit numbers can name");
  }
  if (auto values = check_values(surface); !values) return in_context("surface", values.error());
  const std::vector<std::vector<Vec3>> poses = unit_poses(surface.positions, others);
  const std::vector<Vec3>& positions = poses.front();
  std::vector<Face> faces;
  for (const Face& face : surface.faces) {
    if (has_three_corners(face, surface.vertex_count())) faces.push_back(face);
  }
  PrefixOrder prefix;
  const auto new_from_source = order_vertices(faces.empty() ? progressive::contract_points(positions, unwanted)
                                                            : progressive::contract_mesh(poses, faces, seams, unwanted),
                                              positions, prefix);
  order_faces(surface, new_from_source, prefix);
  return prefix;
}

std::uint32_t prefix_face_count(std::span<const std::uint32_t> death, std::uint32_t N) {
  return static_cast<std::uint32_t>(std::lower_bound(death.begin(), death.end(), N) - death.begin());
}

std::uint32_t prefix_corner(std::span<const std::uint32_t> map, std::uint32_t a, std::uint32_t N) {
  while (a >= N) {
    assert(map[a] < a);
    a = map[a];
  }
  return a;
}

}  // namespace eigencast
