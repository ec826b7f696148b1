// SPDX-License-Identifier: MIT
#include "common/surface/checks/orientation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "common/surface/checks/surface_distance.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kNoFace = ~std::uint32_t{0};
constexpr std::size_t kMaxSamples = std::size_t{1} << 18;  // of all patches: two rays each
constexpr std::size_t kMaxSamplesOfPatch = 64;

std::vector<Face> welded_faces(const Surface& surface) {
  const std::vector<Vec3>& p = surface.positions;
  std::vector<std::uint32_t> order(p.size()), first(p.size());
  std::iota(order.begin(), order.end(), 0U);
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return p[a] < p[b]; });
  for (std::size_t i = 0; i < order.size(); ++i)
    first[order[i]] = i > 0 && p[order[i]] == p[order[i - 1]] ? first[order[i - 1]] : order[i];
  std::vector<Face> faces = surface.faces;
  for (Face& face : faces) {
    for (std::uint32_t& corner : face) corner = first[corner];
  }
  return faces;
}

bool contradicts(std::span<const EdgeUse> uses) {
  bool any = false;
  for_each_edge(uses,
                [&](std::span<const EdgeUse> edge) { any |= edge.size() == 2 && edge[0].upwards == edge[1].upwards; });
  return any;
}

/// Closed, and more of it is wound inwards.
bool encloses_nothing(const Surface& surface, std::span<const EdgeUse> uses) {
  bool is_closed = true;
  for_each_edge(uses, [&](std::span<const EdgeUse> edge) { is_closed &= edge.size() == 2; });
  if (!is_closed || surface.faces.empty()) return false;
  const std::vector<Vec3>& p = surface.positions;
  const Vec3 origin = p[surface.faces[0][0]];
  double volume = 0;
  for (const auto& [a, b, c] : surface.faces) volume += dot(p[a] - origin, cross(p[b] - origin, p[c] - origin));
  return volume < 0;
}

/// The next number of a sequence that fills 0 to 1 evenly: multiples of an irrational number.
double part_of(std::size_t i, double step) {
  const double all = (static_cast<double>(i) + 0.5) * step;
  return all - std::floor(all);
}

/// Which side of a patch is its outside, from the rays that left its samples so far.
struct Sides {
  int free_front = 0, free_back = 0;
  double front = 0, back = 0;  ///< Sums of the ways to the next face, at most the diagonal each.
  double area = 0, turned_area = 0;

  void add(double way_front, double way_back, double diagonal) {
    free_front += std::isinf(way_front) ? 1 : 0;
    free_back += std::isinf(way_back) ? 1 : 0;
    front += std::min(way_front, diagonal);
    back += std::min(way_back, diagonal);
  }
  bool is_inside_out() const {
    if (free_front != free_back) return free_back > free_front;
    if (std::abs(front - back) > 1e-3 * (front + back)) return back > front;
    return turned_area > area / 2;
  }
};

/// Samples a patch evenly by area, and sends rays from there to both sides.
class SideFinder {
 public:
  SideFinder(const Surface& surface, const std::vector<bool>& turned)
      : surface_(surface),
        turned_(turned),
        hits_(surface.positions, surface.faces),
        diagonal_(bounding_box(surface.positions).diagonal()) {}

  Vec3 normal(std::uint32_t face) const {
    const auto& [a, b, c] = surface_.faces[face];
    const std::vector<Vec3>& p = surface_.positions;
    const Vec3 n = cross(p[b] - p[a], p[c] - p[a]);
    return turned_[face] ? -1.0 * n : n;
  }

  bool is_inside_out(std::span<const std::uint32_t> faces, std::size_t samples) const {
    Sides sides;
    std::vector<double> until;
    for (const std::uint32_t face : faces) {
      const double area = length(normal(face));
      until.push_back(sides.area += area);
      if (turned_[face]) sides.turned_area += area;
    }
    for (std::size_t i = 0; i < samples && sides.area > 0; ++i) {
      const double at = (static_cast<double>(i) + 0.5) / static_cast<double>(samples) * sides.area;
      const auto found = std::upper_bound(until.begin(), until.end(), at) - until.begin();
      sample(faces[std::min(static_cast<std::size_t>(found), faces.size() - 1)], i, sides);
    }
    return sides.is_inside_out();
  }

 private:
  void sample(std::uint32_t face, std::size_t i, Sides& sides) const {
    const Vec3 n = normal(face);
    const double twice_area = length(n);
    if (!(twice_area > 0)) return;
    const auto& [a, b, c] = surface_.faces[face];
    const std::vector<Vec3>& p = surface_.positions;
    const double root = std::sqrt(part_of(i, 0.7548776662466927)), along = part_of(i, 0.5698402909980532);
    const Vec3 from = (1 - root) * p[a] + (root * (1 - along)) * p[b] + (root * along) * p[c];
    // Evenly over the disc below the hemisphere: as a matt surface is seen.
    const Vec3 up = 1 / twice_area * n, side = unit(p[b] - p[a]), beside = cross(up, side);
    const double squared = 0.9 * part_of(i, 0.8191725133961645), turn = 6.283185307 * part_of(i, 0.6710436067037893);
    const Vec3 ray = std::sqrt(1 - squared) * up + (std::sqrt(squared) * std::cos(turn)) * side +
                     (std::sqrt(squared) * std::sin(turn)) * beside;
    const double beyond = 1e-7 * diagonal_;
    sides.add(hits_.way_to(from, ray, beyond), hits_.way_to(from, -1.0 * ray, beyond), diagonal_);
  }

  const Surface& surface_;
  const std::vector<bool>& turned_;
  const SurfaceDistance hits_;
  const double diagonal_;
};

}  // namespace

OrientedPatches oriented_patches(std::span<const EdgeUse> uses, std::size_t face_count) {
  struct Neighbour {
    std::uint32_t face = kNoFace;
    bool same_direction = false;
  };
  std::vector<std::array<Neighbour, 3>> across(face_count);
  for_each_edge(uses, [&](std::span<const EdgeUse> edge) {
    if (edge.size() != 2) return;
    const bool same = edge[0].upwards == edge[1].upwards;
    across[edge[0].face][edge[0].side] = {edge[1].face, same};
    across[edge[1].face][edge[1].side] = {edge[0].face, same};
  });
  OrientedPatches patches{std::vector<bool>(face_count), std::vector<std::uint32_t>(face_count, kNoFace), 0};
  std::vector<std::uint32_t> front;
  for (std::uint32_t first = 0; first < face_count; ++first) {
    if (patches.patch[first] != kNoFace) continue;
    patches.patch[first] = patches.count;
    front.push_back(first);
    while (!front.empty()) {
      const std::uint32_t face = front.back();
      front.pop_back();
      for (const Neighbour& neighbour : across[face]) {
        if (neighbour.face == kNoFace || patches.patch[neighbour.face] != kNoFace) continue;
        patches.patch[neighbour.face] = patches.count;
        patches.turned[neighbour.face] = patches.turned[face] != neighbour.same_direction;
        front.push_back(neighbour.face);
      }
    }
    ++patches.count;
  }
  return patches;
}

std::vector<bool> faces_to_turn(const Surface& surface) {
  if (surface.is_point_cloud()) return {};
  const std::vector<EdgeUse> uses = edge_uses(welded_faces(surface), surface.vertex_count());
  if (!contradicts(uses) && !encloses_nothing(surface, uses)) return {};
  OrientedPatches patches = oriented_patches(uses, surface.faces.size());
  std::vector<std::uint32_t> order(surface.faces.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return patches.patch[a] < patches.patch[b]; });
  const std::size_t samples = std::min(kMaxSamplesOfPatch, kMaxSamples / patches.count);
  std::vector<bool> inside_out(patches.count);
  const SideFinder sides(surface, patches.turned);
  for (std::size_t first = 0, last = 0; first < order.size(); first = last) {
    const std::uint32_t patch = patches.patch[order[first]];
    while (last < order.size() && patches.patch[order[last]] == patch) ++last;
    inside_out[patch] = sides.is_inside_out(std::span(order).subspan(first, last - first), samples);
  }
  for (std::size_t f = 0; f < order.size(); ++f) patches.turned[f] = patches.turned[f] != inside_out[patches.patch[f]];
  return std::move(patches.turned);
}

}  // namespace eigencast
