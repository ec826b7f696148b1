// SPDX-License-Identifier: MIT
#include "common/progressive/wedges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace eigencast {
namespace {

constexpr int kAround = 48, kAcross = 24;

/// A tube along z with a bulge, open at both ends, whose uvs are (longitude, z): a seam runs along longitude 0.
struct Tube {
  Surface surface;
  std::vector<CornerUvs> uvs;
};

Tube tube() {
  Tube t;
  for (int j = 0; j <= kAcross; ++j) {
    for (int i = 0; i < kAround; ++i) {
      const double a = 2 * M_PI * i / kAround, z = static_cast<double>(j) / kAcross;
      const double r = 0.3 + 0.1 * std::sin(3 * z) + 0.02 * std::sin(5 * a);
      t.surface.positions.push_back({r * std::cos(a), r * std::sin(a), z});
    }
  }
  const auto uv_at = [](int i, int j) {
    return GridUv{static_cast<std::uint16_t>(60000 * i / kAround), static_cast<std::uint16_t>(60000 * j / kAcross)};
  };
  for (int j = 0; j < kAcross; ++j) {
    for (int i = 0; i < kAround; ++i) {
      const auto at = [&](int di, int dj) {
        return static_cast<std::uint32_t>((j + dj) * kAround + (i + di) % kAround);
      };
      t.surface.faces.push_back({at(0, 0), at(1, 0), at(1, 1)});
      t.uvs.push_back({uv_at(i, j), uv_at(i + 1, j), uv_at(i + 1, j + 1)});
      t.surface.faces.push_back({at(0, 0), at(1, 1), at(0, 1)});
      t.uvs.push_back({uv_at(i, j), uv_at(i + 1, j + 1), uv_at(i, j + 1)});
    }
  }
  return t;
}

std::uint32_t vertex_of(const WedgeOrder& wedges, std::uint32_t wedge) {
  const auto after = std::upper_bound(wedges.first_wedge.begin(), wedges.first_wedge.end(), wedge);
  return static_cast<std::uint32_t>(after - wedges.first_wedge.begin()) - 1;
}

TEST(Wedges, SeamEdgesLieBetweenTwoUvs) {
  const Tube t = tube();
  const auto seams = seam_edges(t.surface.faces, t.uvs);
  ASSERT_EQ(seams.size(), static_cast<std::size_t>(kAcross));
  for (const auto& [low, high] : seams) {
    EXPECT_EQ(low % kAround, 0u);
    EXPECT_EQ(high, low + kAround);
  }
}

TEST(Wedges, FollowTheirVerticesAtEveryLevel) {
  const Tube t = tube();
  const auto order = build_prefix_order(t.surface);
  ASSERT_TRUE(order);
  const WedgeOrder wedges = build_wedges(*order, t.uvs);
  ASSERT_EQ(wedges.first_wedge.size(), order->map.size() + 1);
  for (std::uint32_t f = 0; f < order->faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      std::uint32_t v = order->faces[f][k], w = wedges.corners[f][k];
      EXPECT_EQ(wedges.uvs[w], t.uvs[order->face_source[f]][k]) << "each corner's own at full detail";
      while (true) {
        ASSERT_EQ(vertex_of(wedges, w), v);
        if (v < order->base_count) break;
        v = order->map[v];
        w = wedges.parent[w];
      }
      EXPECT_EQ(wedges.parent[w], w);
    }
  }
}

/// What is wrong with the uvs at a level: the largest distance round the tube between where a corner lies in the
/// image and where it lies on the tube, and the widest that a face is in the image; in parts of a turn.
struct Distortion {
  double wrong = 0, widest = 0;
};
Distortion distortion(const PrefixOrder& order, const WedgeOrder& wedges, std::uint32_t N) {
  Distortion worst;
  for (std::uint32_t f = 0; f < prefix_face_count(order.death, N); ++f) {
    double low = 1, high = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t v = prefix_corner(order.map, order.faces[f][k], N);
      std::uint32_t w = wedges.corners[f][k];
      while (w >= wedges.first_wedge[N]) w = wedges.parent[w];
      const double u = wedges.uvs[w][0] / 60000.0;
      const double turn = static_cast<double>(order.order[v] % kAround) / kAround;
      worst.wrong = std::max(worst.wrong, std::abs(std::remainder(u - turn, 1.0)));
      low = std::min(low, u);
      high = std::max(high, u);
    }
    worst.widest = std::max(worst.widest, high - low);
  }
  return worst;
}

TEST(Wedges, NoFaceRunsBackAcrossTheImage) {
  const Tube t = tube();
  const auto seams = seam_edges(t.surface.faces, t.uvs);
  const auto order = build_prefix_order(t.surface, seams);
  ASSERT_TRUE(order);
  const WedgeOrder wedges = build_wedges(*order, t.uvs);
  const auto n = static_cast<std::uint32_t>(order->map.size());
  EXPECT_LT(wedges.uvs.size(), n + 2 * (kAcross + 1)) << "hardly more than the surface and its seam have";
  for (const double level : {1.0, 0.5, 0.2, 0.1, 0.05}) {
    const auto N = std::max(order->base_count, static_cast<std::uint32_t>(level * n));
    const Distortion worst = distortion(*order, wedges, N);
    EXPECT_LT(worst.widest, 0.5) << level;
    EXPECT_LT(worst.wrong, level < 0.1 ? 0.2 : 0.05) << level;
  }
}

TEST(Wedges, SidesOfSeamsNeverMix) {
  const Tube t = tube();
  const auto order = build_prefix_order(t.surface);
  ASSERT_TRUE(order);
  const WedgeOrder wedges = build_wedges(*order, t.uvs);
  const auto N = static_cast<std::uint32_t>(0.1 * static_cast<double>(order->map.size()));
  EXPECT_LT(distortion(*order, wedges, N).widest, 0.6);
}

TEST(Wedges, UnreferencedVerticesHaveNone) {
  Surface surface{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 1}, {2, 2, 2}, {3, 1, 0}}, {{0, 1, 2}, {1, 3, 2}}};
  const std::vector<CornerUvs> uvs{{GridUv{0, 0}, {9, 0}, {0, 9}}, {GridUv{9, 0}, {9, 9}, {0, 9}}};
  const auto order = build_prefix_order(surface);
  ASSERT_TRUE(order);
  const WedgeOrder wedges = build_wedges(*order, uvs);
  EXPECT_EQ(wedges.uvs.size(), 4u);
  EXPECT_TRUE(seam_edges(surface.faces, uvs).empty());
}

}  // namespace
}  // namespace eigencast
