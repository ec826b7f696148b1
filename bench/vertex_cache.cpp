// SPDX-License-Identifier: MIT
//
// vertex_cache SURFACE...: vertices that a card with a cache of 16 computes for a triangle (ACMR) at levels of detail
// (names as of named_surface.h): with faces in their prefix order; in meshoptimizer's order of the level alone, which
// is no prefix of the next level's; and in its order within blocks of deaths, each GROWTH times as many vertices as the
// one before, where a level draws its last block whole.
#include <meshoptimizer.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>

#include "bench/named_surface.h"
#include "common/progressive/prefix.h"

namespace {

using namespace eigencast;
using Indices = std::vector<unsigned>;

constexpr unsigned kCache = 16;

/// Corners of the faces from `first` to before `end` at level N.
Indices corners_of(const PrefixOrder& order, std::size_t first, std::size_t end, std::uint32_t N) {
  Indices corners;
  for (std::size_t f = first; f < end; ++f) {
    for (const std::uint32_t corner : order.faces[f]) corners.push_back(prefix_corner(order.map, corner, N));
  }
  return corners;
}

Indices optimised(const Indices& corners, std::size_t vertices) {
  Indices result(corners.size());
  meshopt_optimizeVertexCache(result.data(), corners.data(), corners.size(), vertices);
  return result;
}

/// For each of `faces` faces that are seen.
double computed(const Indices& drawn, std::size_t vertices, std::size_t faces) {
  const auto statistics = meshopt_analyzeVertexCache(drawn.data(), drawn.size(), vertices, kCache, 0, 0);
  return static_cast<double>(statistics.vertices_transformed) / static_cast<double>(faces);
}

Indices in_blocks(const PrefixOrder& order, std::uint32_t N, double growth) {
  const auto n = static_cast<std::uint32_t>(order.order.size());
  const std::uint32_t alive = prefix_face_count(order.death, N);
  Indices drawn;
  double end = order.base_count;
  for (std::uint32_t first = 0, last = 0; first < alive; first = last) {
    for (; last == first; end *= growth)
      last = prefix_face_count(order.death, static_cast<std::uint32_t>(std::min<double>(std::round(end), n)));
    for (const unsigned corner : optimised(corners_of(order, first, last, n), n))
      drawn.push_back(prefix_corner(order.map, corner, N));
  }
  return drawn;
}

void print_level(const PrefixOrder& order, double fraction) {
  const std::size_t n = order.order.size();
  const auto N = std::max(order.base_count, static_cast<std::uint32_t>(std::lround(fraction * static_cast<double>(n))));
  const std::uint32_t faces = prefix_face_count(order.death, N);
  const Indices prefix = corners_of(order, 0, faces, N);
  std::printf("%5.0f %% %7u faces   prefix %.2f   free %.2f", 100 * fraction, faces, computed(prefix, n, faces),
              computed(optimised(prefix, n), n, faces));
  for (const double growth : {1.06, 1.25, 2.0}) {
    const Indices drawn = in_blocks(order, N, growth);
    std::printf("   blocks x %.2f: %.2f (%+.0f %% drawn)", growth, computed(drawn, n, faces),
                100.0 * (static_cast<double>(drawn.size()) / 3 / faces - 1));
  }
  std::puts("");
}

}  // namespace

int main(int count, char** arguments) {
  for (int i = 1; i < count; ++i) {
    const PrefixOrder order = build_prefix_order(bench::named_surface(arguments[i])).value();
    std::puts(arguments[i]);
    for (const double fraction : {1.0, 0.5, 0.2, 0.1, 0.05}) print_level(order, fraction);
  }
  return count > 1 ? 0 : 2;
}
