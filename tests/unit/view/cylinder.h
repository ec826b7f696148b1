// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "common/surface/formats/read.h"
#include "sdk/bake.h"
#include "tests/support/process.h"

namespace eigencast::testing {

/// Baked from an OBJ whose normals say that the sides are round and the caps flat, with coarser levels.
inline const Asset& cylinder_asset() {
  static const Asset asset = [] {
    constexpr int kSides = 16, kRings = 5;
    const TemporaryFolder folder;
    const std::string path = folder.file("cylinder.obj");
    std::ofstream out(path);
    for (int i = 0; i < kSides * kRings; ++i) {
      const double angle = 2 * M_PI * (i % kSides) / kSides, y = 2.0 * (i / kSides) / (kRings - 1) - 1;
      out << "v " << std::cos(angle) << " " << y << " " << -std::sin(angle) << "\n";
      if (i < kSides) out << "vn " << std::cos(angle) << " 0 " << -std::sin(angle) << "\n";
    }
    out << "v 0 -1 0\nv 0 1 0\nvn 0 -1 0\nvn 0 1 0\n";
    const int low = kSides * kRings + 1, down = kSides + 1;
    for (int i = 0; i < kSides; ++i) {
      const int next = (i + 1) % kSides, top = kSides * (kRings - 1);
      const auto corner = [](int vertex, int normal) {
        return " " + std::to_string(vertex) + "//" + std::to_string(normal);
      };
      out << "f" << corner(low, down) << corner(next + 1, down) << corner(i + 1, down) << "\n";
      out << "f" << corner(low + 1, down + 1) << corner(top + i + 1, down + 1) << corner(top + next + 1, down + 1)
          << "\n";
      for (int ring = 0; ring + 1 < kRings; ++ring) {
        const int a = kSides * ring + 1;
        out << "f" << corner(a + i, i + 1) << corner(a + next, next + 1) << corner(a + kSides + next, next + 1)
            << corner(a + kSides + i, i + 1) << "\n";
      }
    }
    out.close();
    Appearance appearance;
    const auto surface = read_surface(path, &appearance);
    EXPECT_TRUE(surface) << surface.error().message;
    BakeOptions options;
    options.rank = 40;
    options.appearance = &appearance;
    auto result = bake(*surface, options);
    EXPECT_TRUE(result) << result.error().message;
    return std::move(result->asset);
  }();
  return asset;
}

}  // namespace eigencast::testing
