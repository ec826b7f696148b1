// SPDX-License-Identifier: MIT
//
// splat_levels SURFACE...: how well discs stand for a cloud at its levels of detail (faces, if there are any, are left
// out; names as of named_surface.h). Of each level: radii of the discs over the mean distance to the six nearest of the
// level's points, mean and largest; and how far the discs' own points lie from the nearest point of the whole cloud,
// over the diagonal: root mean square over the discs' area, 99th percentile, largest. The limit of the latter at a
// level is what discs of its full cloud leave.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <string>
#include <vector>

#include "bench/named_surface.h"
#include "common/progressive/neighbours.h"
#include "common/progressive/point_normals.h"
#include "common/progressive/prefix.h"
#include "common/progressive/splats.h"
#include "common/surface/vector.h"

namespace {

using namespace eigencast;
using progressive::Neighbours;

constexpr std::size_t kNeighbours = 6;
constexpr int kRings = 4, kRays = 12;

double distance(const Vec3& a, const Vec3& b) {
  return length(a - b);
}

std::vector<std::uint32_t> first_rows(std::size_t count) {
  std::vector<std::uint32_t> rows(count);
  std::iota(rows.begin(), rows.end(), 0U);
  return rows;
}

/// A cloud with all that its discs are made of, by rows.
struct Discs {
  explicit Discs(const Surface& cloud) : order(build_prefix_order(cloud).value()) {
    const std::vector<Vec3> turned = oriented_normals(cloud.positions);
    splats = build_splats(cloud.positions, turned, order);
    for (const std::uint32_t i : order.order) {
      positions.push_back(cloud.positions[i]);
      normals.push_back(turned[i]);
    }
    const Box box = bounding_box(cloud.positions);
    diagonal = distance(box.low, box.high);
  }
  std::vector<double> radii(std::uint32_t N) const {
    std::vector<double> at_level(splats.radius.begin(), splats.radius.begin() + N);
    for (std::uint32_t i = order.base_count; i < N; ++i) at_level[order.map[i]] = splats.parent_radius[i];
    return at_level;
  }

  PrefixOrder order;
  PointSplats splats;
  std::vector<Vec3> positions, normals;
  double diagonal = 0;
};

/// Points spread over a disc, as many for each part of its area.
std::vector<Vec3> points_of_disc(const Vec3& centre, const Vec3& normal, double radius) {
  const Vec3 aside = std::abs(normal[0]) < 0.7 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const auto axes = frame_from_points({}, cross(normal, aside), normal);  // the first and the third lie in it
  std::vector<Vec3> points;
  for (int ring = 0; ring < kRings; ++ring) {
    const double r = radius * std::sqrt((ring + 1.0) / kRings);
    for (int ray = 0; ray < kRays; ++ray) {
      const double angle = 2 * M_PI * (ray + 0.5 * (ring % 2)) / kRays;
      Vec3 p = centre;
      for (std::size_t d = 0; d < 3; ++d) p[d] += r * (std::cos(angle) * axes[0][d] + std::sin(angle) * axes[2][d]);
      points.push_back(p);
    }
  }
  return points;
}

void print_level(const Discs& discs, const Neighbours& whole, double fraction) {
  const auto n = static_cast<double>(discs.positions.size());
  const auto N = std::max(discs.order.base_count, static_cast<std::uint32_t>(std::lround(fraction * n)));
  const std::vector<double> radii = discs.radii(N);
  const Neighbours level(discs.positions, first_rows(N));
  double ratios = 0, largest_ratio = 0, squares = 0, area = 0;
  std::vector<double> off;
  for (std::uint32_t i = 0; i < N; ++i) {
    const Vec3& centre = discs.positions[i];
    const auto around = level.nearest(centre, kNeighbours + 1);
    double spacing = 0;
    for (const std::uint32_t j : around) spacing += distance(centre, discs.positions[j]) / kNeighbours;
    if (!(spacing > 0)) continue;
    ratios += radii[i] / spacing;
    largest_ratio = std::max(largest_ratio, radii[i] / spacing);
    const auto points = points_of_disc(centre, discs.normals[i], radii[i]);
    const double share = radii[i] * radii[i] / static_cast<double>(points.size());
    for (const Vec3& p : points) {
      off.push_back(distance(p, discs.positions[whole.nearest(p, 1).front()]) / discs.diagonal);
      squares += share * off.back() * off.back();
      area += share;
    }
  }
  const auto at = off.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(off.size()));
  std::nth_element(off.begin(), at, off.end());
  std::printf("%5.0f %% %7u discs   radius / spacing %.2f, %.2f   off the cloud %.2e rms, %.2e, %.2e\n", 100 * fraction,
              N, ratios / N, largest_ratio, std::sqrt(squares / area), *at, *std::max_element(at, off.end()));
}

}  // namespace

int main(int count, char** arguments) {
  for (int i = 1; i < count; ++i) {
    Surface cloud = bench::named_surface(arguments[i]);
    cloud.faces.clear();
    const Discs discs(cloud);
    const Neighbours whole(discs.positions, first_rows(discs.positions.size()));
    std::printf("%s\n", arguments[i]);
    for (const double fraction : {1.0, 0.1, 0.05, 0.02}) print_level(discs, whole, fraction);
  }
  return count > 1 ? 0 : 2;
}
