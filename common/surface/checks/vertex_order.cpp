// SPDX-License-Identifier: MIT
#include "common/surface/checks/vertex_order.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/core/text.h"
#include "common/surface/edge_uses.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr std::size_t kMaxFaces = 2'000'000;
constexpr double kFolded = -0.3;  // cosine between the normals of faces that lie on each other
// Parts of the edges, beyond those of the rest pose; surfaces that were squashed flat have up to 0.2.
constexpr float kManyFolded = 0.2F;
constexpr float kSurelyFolded = 0.3F;
constexpr float kManyFoldedAtRest = 0.15F;
// Vertices taken at even strides from a regular grid make a smooth surface again, but of long edges.
constexpr float kLongEdges = 2.5F, kSurelyLongEdges = 8;
constexpr std::size_t kFewPairs = 100, kEnoughPairs = 1000;
// In lengths of edges nearby: 0.7 at most in animations, about 1 where surfaces are stretched to rags.
constexpr float kStray = 1.5F;
constexpr float kFarStray = 0.01F;  // of the diagonal
constexpr double kFull = 0.01;      // a ball's is 0.094
constexpr double kClosed = 1e-6;

/// Twice the face's area long.
Vec3 normal_of(const Face& face, std::span<const Vec3> positions) {
  const Vec3& corner = positions[face[0]];
  return cross(positions[face[1]] - corner, positions[face[2]] - corner);
}

}  // namespace

std::string percent_text(float part) {
  return formatted("%.*f %%", part < 0.0995F ? 1 : 0, static_cast<double>(part) * 100);
}

std::string Misfit::text() const {
  switch (kind) {
    case Kind::kOrder:
      return (stretch > kLongEdges
                  ? "edges are " + formatted("%.3g", double{stretch}) + " times as long as in the rest pose, "
                  : std::string()) +
             percent_text(folded) +
             " of the edges have their two faces folded on each other; is the order of vertices another?";
    case Kind::kInsideOut:
      return "the surface is inside out; is it mirrored, or are two of its axes exchanged?";
    case Kind::kVertex:
      return "vertex " + std::to_string(vertex) + " lies " + percent_text(away) +
             " of the diagonal away from its neighbours" +
             (others > 0 ? ", and " + std::to_string(others) + " more lie away from theirs" : "") +
             "; is it misplaced, or has the order of vertices changed?";
    case Kind::kNone:
      break;
  }
  assert(false);
  return {};
}

VertexOrder::VertexOrder(const Surface& rest)
    : faces_(rest.faces.begin(),
             rest.faces.begin() + static_cast<std::ptrdiff_t>(std::min(rest.faces.size(), kMaxFaces))),
      degree_(rest.vertex_count(), 0),
      diagonal_(std::max(bounding_box(rest.positions).diagonal(), 1e-30)) {
  const std::vector<EdgeUse> uses = edge_uses(faces_, rest.vertex_count());
  for_each_edge(std::span(uses), [&](std::span<const EdgeUse> edge) {
    edges_.emplace_back(edge[0].low, edge[0].high);
    ++degree_[edge[0].low];
    ++degree_[edge[0].high];
    for (std::size_t i = 1; i < edge.size(); ++i) {
      if (edge[i - 1].upwards != edge[i].upwards) face_pairs_.emplace_back(edge[i - 1].face, edge[i].face);
    }
  });
  edge_length_ = edge_length(rest.positions);
  at_rest_ = locals(rest.positions);
  rest_.folded = folded(rest.positions);
  if (face_pairs_.size() >= kEnoughPairs && rest_.folded > kManyFoldedAtRest) {
    rest_.kind = Misfit::Kind::kOrder;
    rest_.certain = rest_.folded > kSurelyFolded;
  }
  if (faces_.size() == rest.faces.size()) fullness_ = fullness(rest.positions);
}

Misfit VertexOrder::check(std::span<const Vec3> positions) const {
  assert(positions.size() == degree_.size());
  Misfit misfit;
  misfit.folded = folded(positions);
  misfit.stretch = stretch(positions);
  if (rest_.kind != Misfit::Kind::kNone) return misfit;
  const float more = misfit.folded - rest_.folded;
  const bool enough = face_pairs_.size() >= kEnoughPairs;
  misfit.certain = enough && (more > kSurelyFolded || misfit.stretch > kSurelyLongEdges);
  if (misfit.certain || (face_pairs_.size() >= kFewPairs && (more > kManyFolded || misfit.stretch > kLongEdges))) {
    misfit.kind = Misfit::Kind::kOrder;
    return misfit;
  }
  if (std::abs(fullness_) > kFull) {
    const double now = fullness(positions);
    if (now * fullness_ < 0 && std::abs(now) > std::abs(fullness_) / 2) misfit.kind = Misfit::Kind::kInsideOut;
  }
  if (misfit.kind == Misfit::Kind::kNone) find_strays(positions, misfit);
  return misfit;
}

std::vector<VertexOrder::Local> VertexOrder::locals(std::span<const Vec3> positions) const {
  const std::size_t n = positions.size();
  std::vector<double> lengths(n, 0), rings(n, 0), ring_edges(n, 0);
  std::vector<Vec3> sums(n, Vec3{});
  std::vector<float> edge_lengths;
  edge_lengths.reserve(edges_.size());
  for (const auto& [a, b] : edges_) {
    const double length = std::sqrt(squared_distance(positions[a], positions[b]));
    edge_lengths.push_back(static_cast<float>(length));
    lengths[a] += length;
    lengths[b] += length;
    sums[a] = sums[a] + positions[b];
    sums[b] = sums[b] + positions[a];
  }
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const auto& [a, b] = edges_[e];
    const double length = double{edge_lengths[e]};
    rings[a] += std::max(0.0, lengths[b] - length);
    rings[b] += std::max(0.0, lengths[a] - length);
    ring_edges[a] += degree_[b] - 1;
    ring_edges[b] += degree_[a] - 1;
  }
  std::vector<Local> locals(n);
  for (std::size_t i = 0; i < n; ++i) {
    if (degree_[i] == 0) continue;
    const Vec3 mean{sums[i][0] / degree_[i], sums[i][1] / degree_[i], sums[i][2] / degree_[i]};
    locals[i] = {static_cast<float>(lengths[i] / degree_[i]),
                 static_cast<float>(ring_edges[i] > 0 ? rings[i] / ring_edges[i] : 0),
                 static_cast<float>(std::sqrt(squared_distance(positions[i], mean)))};
  }
  return locals;
}

void VertexOrder::find_strays(std::span<const Vec3> positions, Misfit& misfit) const {
  const std::vector<Local> now = locals(positions);
  std::uint32_t strays = 0;
  for (std::size_t i = 0; i < now.size(); ++i) {
    const Local& rest = at_rest_[i];
    if (!(rest.ring > 0 && now[i].ring > 0)) continue;
    const float stretch = now[i].ring / rest.ring;
    // With the own edges of the rest pose: those of the middle of a fan are far longer than its neighbours' others.
    const float around = std::max(now[i].ring, stretch * rest.incident);
    const float off = now[i].off - stretch * rest.off;
    const float away = off / stretch / static_cast<float>(diagonal_);
    if (!(off > kStray * around && away > kFarStray)) continue;
    ++strays;
    if (away <= misfit.away) continue;
    misfit.away = away;
    misfit.vertex = static_cast<std::uint32_t>(i);
  }
  if (strays == 0) return;
  misfit.kind = Misfit::Kind::kVertex;
  misfit.others = strays - 1;
}

double VertexOrder::edge_length(std::span<const Vec3> positions) const {
  double sum = 0;
  for (const auto& [a, b] : edges_) sum += squared_distance(positions[a], positions[b]);
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, edges_.size())));
}

float VertexOrder::stretch(std::span<const Vec3> positions) const {
  if (!(edge_length_ > 0)) return 1;
  const double longer = edge_length(positions) / edge_length_;
  // Crumpled, a surface has a smaller box; in other units, edges of other lengths.
  return static_cast<float>(std::min(longer, longer * diagonal_ / std::max(bounding_box(positions).diagonal(), 1e-30)));
}

float VertexOrder::folded(std::span<const Vec3> positions) const {
  std::vector<Vec3> normals;
  normals.reserve(faces_.size());
  for (const Face& face : faces_) normals.push_back(unit(normal_of(face, positions)));
  std::size_t count = 0;
  for (const auto& [f, g] : face_pairs_) count += dot(normals[f], normals[g]) < kFolded ? 1 : 0;
  return static_cast<float>(count) / static_cast<float>(std::max<std::size_t>(1, face_pairs_.size()));
}

double VertexOrder::fullness(std::span<const Vec3> positions) const {
  if (positions.empty()) return 0;
  double volume = 0, area = 0;
  Vec3 sum{};
  const Vec3 near = positions.front();
  for (const Face& face : faces_) {
    const Vec3 normal = normal_of(face, positions);
    volume += dot(positions[face[0]] - near, normal) / 6;
    area += length(normal) / 2;
    sum = sum + 0.5 * normal;
  }
  if (!(area > 0) || length(sum) > kClosed * area) return 0;
  return volume / std::pow(area, 1.5);
}

}  // namespace eigencast
