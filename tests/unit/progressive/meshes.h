// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <random>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::testing {

// An octahedron, subdivided on the unit sphere: 4^(s+1) + 2 vertices.
inline Surface sphere(int subdivisions) {
  Surface s{{{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}},
            {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}}};
  for (int round = 0; round < subdivisions; ++round) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middle;
    const auto middle_of = [&](std::uint32_t a, std::uint32_t b) {
      const auto [entry, is_new] =
          middle.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(s.positions.size()));
      if (is_new) {
        Vec3 p;
        for (std::size_t d = 0; d < 3; ++d) p[d] = s.positions[a][d] + s.positions[b][d];
        const double length = std::hypot(p[0], p[1], p[2]);
        s.positions.push_back({p[0] / length, p[1] / length, p[2] / length});
      }
      return entry->second;
    };
    std::vector<Face> faces;
    for (const Face& f : s.faces) {
      const std::uint32_t a = middle_of(f[0], f[1]), b = middle_of(f[1], f[2]), c = middle_of(f[2], f[0]);
      for (const Face& part : {Face{f[0], a, c}, Face{f[1], b, a}, Face{f[2], c, b}, Face{a, b, c}})
        faces.push_back(part);
    }
    s.faces = std::move(faces);
  }
  return s;
}

// A grid of quads, each split in two; closed in a direction if it wraps there. `at` gives the position from (u, v) in
// [0, 1).
template <typename At>
Surface grid(std::uint32_t nu, std::uint32_t nv, bool wrap_u, bool wrap_v, At at) {
  Surface s;
  for (std::uint32_t j = 0; j < nv; ++j) {
    for (std::uint32_t i = 0; i < nu; ++i) s.positions.push_back(at(double(i) / nu, double(j) / nv));
  }
  for (std::uint32_t j = 0; j < (wrap_v ? nv : nv - 1); ++j) {
    for (std::uint32_t i = 0; i < (wrap_u ? nu : nu - 1); ++i) {
      const std::uint32_t right = (i + 1) % nu, up = (j + 1) % nv;
      const std::uint32_t a = j * nu + i, b = j * nu + right, c = up * nu + right, d = up * nu + i;
      s.faces.push_back({a, b, c});
      s.faces.push_back({a, c, d});
    }
  }
  return s;
}

inline Surface torus(std::uint32_t around, std::uint32_t across) {
  return grid(around, across, true, true, [](double u, double v) {
    const double a = 2 * M_PI * u, b = 2 * M_PI * v, radius = 1 + 0.4 * std::cos(b);
    return Vec3{radius * std::cos(a), radius * std::sin(a), 0.4 * std::sin(b)};
  });
}

inline Surface flat_square(std::uint32_t n) {
  return grid(n, n, false, false, [](double u, double v) { return Vec3{u, v, 0}; });
}

// Each face with corners of its own, as in an STL file.
inline Surface soup_from(const Surface& surface) {
  Surface soup;
  for (const Face& face : surface.faces) {
    const auto first = static_cast<std::uint32_t>(soup.positions.size());
    for (const std::uint32_t v : face) soup.positions.push_back(surface.positions[v]);
    soup.faces.push_back({first, first + 1, first + 2});
  }
  return soup;
}

inline void append(Surface& to, const Surface& other, Vec3 shift) {
  const auto first = static_cast<std::uint32_t>(to.positions.size());
  for (const Vec3& p : other.positions) to.positions.push_back({p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]});
  for (const Face& f : other.faces) to.faces.push_back({f[0] + first, f[1] + first, f[2] + first});
}

// Faces between random vertices: non-manifold nearly everywhere.
inline Surface tangle(std::uint32_t n, std::uint32_t faces, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> coordinate(-1, 1);
  std::uniform_int_distribution<std::uint32_t> vertex(0, n - 1);
  Surface s;
  for (std::uint32_t i = 0; i < n; ++i)
    s.positions.push_back({coordinate(random), coordinate(random), coordinate(random)});
  for (std::uint32_t f = 0; f < faces; ++f) s.faces.push_back({vertex(random), vertex(random), vertex(random)});
  return s;
}

// Euler characteristic of the faces and the vertices that they use.
inline std::ptrdiff_t euler_characteristic(const std::vector<Face>& faces, std::uint32_t N) {
  std::vector<std::uint64_t> edges;
  std::vector<bool> used(N);
  for (const Face& f : faces) {
    for (std::size_t c = 0; c < 3; ++c) {
      used[f[c]] = true;
      const auto [low, high] = std::minmax(f[c], f[(c + 1) % 3]);
      edges.push_back(std::uint64_t{low} << 32 | high);
    }
  }
  std::sort(edges.begin(), edges.end());
  const auto edge_count = std::unique(edges.begin(), edges.end()) - edges.begin();
  return std::count(used.begin(), used.end(), true) - edge_count + static_cast<std::ptrdiff_t>(faces.size());
}

}  // namespace eigencast::testing
