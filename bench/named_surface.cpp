// SPDX-License-Identifier: MIT
#include "bench/named_surface.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <utility>

#include "common/progressive/prefix.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"

namespace eigencast::bench {
namespace {

[[noreturn]] void end_with(const std::string& what) {
  std::fprintf(stderr, "%s\n", what.c_str());
  std::exit(1);
}

Surface whole_surface(const std::string& name) {
  const auto colon = name.find(':');
  const std::string kind = name.substr(0, colon);
  const int size = colon == std::string::npos ? 0 : std::atoi(name.c_str() + colon + 1);
  if (kind == "heart") return make_heart(size);
  if (kind == "ico") return make_icosphere(size);
  if (kind == "torus") return make_torus(2 * size, size, 1.0, 0.4);
  if (kind == "bar") return make_box(40, 40, 185, {1, 1, 4.625});
  auto surface = read_surface(name);
  if (!surface) end_with(surface.error().message);
  return std::move(*surface);
}

Surface subdivided(const Surface& from) {
  Surface to{from.positions, {}};
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
  const auto middle = [&](std::uint32_t a, std::uint32_t b) {
    const auto [at, fresh] = middles.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(to.positions.size()));
    if (fresh) {
      const Vec3 &p = from.positions[a], &q = from.positions[b];
      to.positions.push_back({(p[0] + q[0]) / 2, (p[1] + q[1]) / 2, (p[2] + q[2]) / 2});
    }
    return at->second;
  };
  for (const auto& [a, b, c] : from.faces) {
    const std::uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
    to.faces.insert(to.faces.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
  }
  return to;
}

Surface contracted(const Surface& from, std::uint32_t N) {
  const auto order = build_prefix_order(from);
  if (!order) end_with(order.error().message);
  if (N < order->base_count || N > from.vertex_count()) end_with("a surface that has no level of " + std::to_string(N));
  Surface to;
  for (std::uint32_t i = 0; i < N; ++i) to.positions.push_back(from.positions[order->order[i]]);
  for (std::uint32_t f = 0; f < prefix_face_count(order->death, N); ++f) {
    Face face = order->faces[f];
    for (std::uint32_t& corner : face) corner = prefix_corner(order->map, corner, N);
    to.faces.push_back(face);
  }
  return to;
}

}  // namespace

Surface named_surface(const std::string& name) {
  const auto level = name.rfind('@'), split = name.rfind('^');
  Surface surface = whole_surface(name.substr(0, std::min(level, split)));
  if (split != std::string::npos) {
    for (int k = std::atoi(name.c_str() + split + 1); k > 0; --k) surface = subdivided(surface);
  }
  if (level == std::string::npos) return surface;
  return contracted(surface, static_cast<std::uint32_t>(std::atoi(name.c_str() + level + 1)));
}

}  // namespace eigencast::bench
