// SPDX-License-Identifier: MIT
#include "common/surface/shapes/shapes.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <utility>

#include "common/surface/vector.h"

namespace eigencast {
namespace {

Vec3 on_unit_sphere(const Vec3& v) {
  const double length = std::hypot(v[0], v[1], v[2]);
  return {v[0] / length, v[1] / length, v[2] / length};
}

Surface icosahedron() {
  constexpr double kGolden = std::numbers::phi;
  Surface s;
  for (const Vec3& v : {Vec3{-1, kGolden, 0}, Vec3{1, kGolden, 0}, Vec3{-1, -kGolden, 0}, Vec3{1, -kGolden, 0},
                        Vec3{0, -1, kGolden}, Vec3{0, 1, kGolden}, Vec3{0, -1, -kGolden}, Vec3{0, 1, -kGolden},
                        Vec3{kGolden, 0, -1}, Vec3{kGolden, 0, 1}, Vec3{-kGolden, 0, -1}, Vec3{-kGolden, 0, 1}}) {
    s.positions.push_back(on_unit_sphere(v));
  }
  s.faces = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
             {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
             {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  return s;
}

// Numbers vertices in the order in which faces first use them.
template <typename Key>
class VertexNumbers {
 public:
  explicit VertexNumbers(std::vector<Vec3>& positions) : positions_(positions) {}
  std::uint32_t number(const Key& key, const Vec3& position) {
    const auto [it, inserted] = numbers_.try_emplace(key, static_cast<std::uint32_t>(positions_.size()));
    if (inserted) positions_.push_back(position);
    return it->second;
  }

 private:
  std::vector<Vec3>& positions_;
  std::map<Key, std::uint32_t> numbers_;
};

// Each face of a closed surface split in k x k flat triangles that share their vertices.
Surface split(const Surface& base, int k) {
  // A lattice point is known by the corners it depends on and their weights, so that neighbours share it.
  using Weight = std::pair<std::uint32_t, int>;
  using Key = std::array<Weight, 3>;
  Surface s;
  VertexNumbers<Key> numbers(s.positions);
  const auto lattice_point = [&](const Face& f, int i, int j) {
    const std::array<int, 3> weights{k - i - j, i, j};
    Key key{};
    std::size_t used = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      if (weights[c] > 0) key[used++] = {f[c], weights[c]};
    }
    std::sort(key.begin(), key.end());
    Vec3 p{};
    for (const auto& [vertex, weight] : key) {
      for (std::size_t c = 0; c < 3; ++c) p[c] += base.positions[vertex][c] * weight / k;
    }
    return numbers.number(key, p);
  };
  for (const Face& f : base.faces) {
    for (int i = 0; i < k; ++i) {
      for (int j = 0; i + j < k; ++j) {
        const std::uint32_t a = lattice_point(f, i, j);
        const std::uint32_t b = lattice_point(f, i + 1, j);
        const std::uint32_t c = lattice_point(f, i, j + 1);
        s.faces.push_back({a, b, c});
        if (i + j + 1 < k) s.faces.push_back({b, lattice_point(f, i + 1, j + 1), c});
      }
    }
  }
  return s;
}

// The heart of Taubin 1994, "Distance approximations for rasterizing implicit curves",
// (x^2 + 9/4 y^2 + z^2 - 1)^3 = (x^2 + 9/80 y^2) z^3, with z up along Y. Of both sides the cube root is taken; that of
// s = x^2 + 9/80 y^2 is softened to s / (s^2 + e)^(1/3), which rounds the cusps at cleft and tip. Negative inside.
struct HeartValue {
  double value;
  Vec3 gradient;
};

HeartValue heart_function(const Vec3& p) {
  constexpr double kSoftness = 0.004;
  const double x2 = p[0] * p[0];
  const double y2 = p[2] * p[2];
  const double z = p[1];
  const double lobes = x2 + 0.1125 * y2;
  const double soft = lobes * lobes + kSoftness;
  const double root = std::cbrt(soft);
  const double slope = z * (1 - 2.0 / 3 * lobes * lobes / soft) / root;
  return {x2 + 2.25 * y2 + z * z - 1 - z * lobes / root,
          {p[0] * (2 - 2 * slope), 2 * z - lobes / root, p[2] * (4.5 - 0.225 * slope)}};
}

// Where the ray through `direction` leaves the heart, which is star-shaped about the origin.
Vec3 along_ray(const Vec3& direction) {
  const Vec3 d = on_unit_sphere(direction);
  double low = 0;
  double high = 2;
  for (int i = 0; i < 52; ++i) {
    const double middle = (low + high) / 2;
    const bool inside = heart_function({d[0] * middle, d[1] * middle, d[2] * middle}).value < 0;
    (inside ? low : high) = middle;
  }
  return {d[0] * low, d[1] * low, d[2] * low};
}

// A point near the heart, put on it along the gradient (Newton). Falls back to the ray where the gradient fades.
Vec3 along_gradient(Vec3 p) {
  for (int i = 0; i < 12; ++i) {
    const auto [value, g] = heart_function(p);
    const double square = dot(g, g);
    if (!(square > 1e-12)) break;
    const double step = value / square;
    for (std::size_t c = 0; c < 3; ++c) p[c] -= step * g[c];
    if (std::abs(value) < 1e-13) return p;
  }
  return along_ray(p);
}

// Moves each vertex towards the area-weighted centre of its triangles and back on the heart: triangles grow even.
void relax_on_heart(Surface& s, int rounds) {
  const std::size_t n = s.vertex_count();
  std::vector<Vec3> sums(n);
  std::vector<double> weights(n);
  for (int round = 0; round < rounds; ++round) {
    sums.assign(n, Vec3{});
    weights.assign(n, 0);
    for (const Face& f : s.faces) {
      const Vec3& a = s.positions[f[0]];
      const Vec3& b = s.positions[f[1]];
      const Vec3& c = s.positions[f[2]];
      const double area = length(cross(b - a, c - a));
      for (const std::uint32_t v : f) {
        for (std::size_t k = 0; k < 3; ++k) sums[v][k] += area * (a[k] + b[k] + c[k]) / 3;
        weights[v] += area;
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      s.positions[i] = along_gradient({sums[i][0] / weights[i], sums[i][1] / weights[i], sums[i][2] / weights[i]});
    }
  }
}

}  // namespace

Surface make_icosphere(int subdivisions) {
  assert(subdivisions >= 0 && subdivisions <= 9);
  Surface s = icosahedron();
  for (int round = 0; round < subdivisions; ++round) {
    std::vector<Face> coarse;
    coarse.swap(s.faces);
    VertexNumbers<std::pair<std::uint32_t, std::uint32_t>> numbers(s.positions);
    const auto middle = [&](std::uint32_t a, std::uint32_t b) {
      const Vec3 p = s.positions[a];
      const Vec3 q = s.positions[b];
      return numbers.number({std::min(a, b), std::max(a, b)}, on_unit_sphere(p + q));
    };
    for (const Face& f : coarse) {
      const std::uint32_t ab = middle(f[0], f[1]);
      const std::uint32_t bc = middle(f[1], f[2]);
      const std::uint32_t ca = middle(f[2], f[0]);
      s.faces.insert(s.faces.end(), {Face{f[0], ab, ca}, Face{f[1], bc, ab}, Face{f[2], ca, bc}, Face{ab, bc, ca}});
    }
  }
  return s;
}

Surface make_torus(int around, int across, double major, double minor) {
  assert(around >= 3 && across >= 3 && major > minor && minor > 0);
  Surface s;
  for (int i = 0; i < around; ++i) {
    const double u = 2 * std::numbers::pi * i / around;
    for (int j = 0; j < across; ++j) {
      const double v = 2 * std::numbers::pi * j / across;
      const double radius = major + minor * std::cos(v);
      s.positions.push_back({radius * std::cos(u), minor * std::sin(v), -radius * std::sin(u)});
    }
  }
  const auto at = [&](int i, int j) { return static_cast<std::uint32_t>((i % around) * across + j % across); };
  for (int i = 0; i < around; ++i) {
    for (int j = 0; j < across; ++j) {
      s.faces.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      s.faces.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  }
  return s;
}

Surface make_box(int nx, int ny, int nz, Vec3 size) {
  assert(nx >= 1 && ny >= 1 && nz >= 1);
  const std::array<int, 3> counts{nx, ny, nz};
  using Key = std::array<int, 3>;
  Surface s;
  VertexNumbers<Key> numbers(s.positions);
  const auto number = [&](const Key& key) {
    Vec3 p{};
    for (std::size_t c = 0; c < 3; ++c) p[c] = size[c] * (static_cast<double>(key[c]) / counts[c] - 0.5);
    return numbers.number(key, p);
  };
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::size_t u = (axis + 1) % 3;
    const std::size_t v = (axis + 2) % 3;
    for (const bool far : {false, true}) {
      for (int i = 0; i < counts[u]; ++i) {
        for (int j = 0; j < counts[v]; ++j) {
          const auto corner = [&](int di, int dj) {
            Key key{};
            key[axis] = far ? counts[axis] : 0;
            key[u] = i + di;
            key[v] = j + dj;
            return number(key);
          };
          std::array<std::uint32_t, 4> q{corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)};
          if (!far) std::swap(q[1], q[3]);
          s.faces.push_back({q[0], q[1], q[2]});
          s.faces.push_back({q[0], q[2], q[3]});
        }
      }
    }
  }
  return s;
}

Surface make_heart(int frequency) {
  assert(frequency >= 1 && frequency <= 500);
  // Coarse to fine, because relaxation evens out far regions slowly.
  const bool refine = frequency % 3 == 0 && frequency >= 27;
  Surface s = split(refine ? make_heart(frequency / 3) : icosahedron(), refine ? 3 : frequency);
  for (Vec3& p : s.positions) p = refine ? along_gradient(p) : along_ray(p);
  relax_on_heart(s, refine ? 30 : 150);
  return s;
}

}  // namespace eigencast
