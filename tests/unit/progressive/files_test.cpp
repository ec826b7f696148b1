// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "common/progressive/prefix.h"
#include "common/surface/checks/check.h"
#include "common/surface/formats/read.h"
#include "tests/support/paths.h"
#include "tests/unit/progressive/meshes.h"

namespace eigencast {
namespace {

std::vector<std::string> mesh_files() {
  std::vector<std::string> files;
  for (const char* folder : {"meshes/clean", "meshes/nasty"}) {
    for (const auto& entry : std::filesystem::directory_iterator(data_dir() / folder)) files.push_back(entry.path());
  }
  files.push_back(gait_clip().replace_filename("rest.obj"));
  return files;
}

TEST(PrefixFiles, EveryMeshThatCanBeReadGetsASoundOrder) {
  const auto files = mesh_files();
  std::size_t built = 0;
  for (const std::string& file : files) {
    SCOPED_TRACE(file);
    const auto surface = read_surface(file);
    if (!surface || !validate_surface(*surface)) continue;
    const auto order = build_prefix_order(*surface);
    ASSERT_TRUE(order) << order.error().message;
    ++built;
    const auto n = static_cast<std::uint32_t>(surface->vertex_count());
    for (std::uint32_t i = order->base_count; i < n; ++i) ASSERT_LT(order->map[i], i);
    EXPECT_LE(order->base_count, std::max(64U, n / 50));

    const SurfaceReport report = check_surface(*surface);
    const bool keeps_topology = report.closed() && report.components == 1 && report.nonmanifold_vertices == 0;
    std::optional<std::ptrdiff_t> characteristic;
    const std::uint32_t q = order->base_count;
    for (const std::uint32_t N : {n, n - n / 4, n / 2, n / 4, n / 10, q + (n - q) / 50, q}) {
      if (N < q) continue;
      std::vector<Face> faces;
      for (std::uint32_t f = 0; f < prefix_face_count(order->death, N); ++f) {
        Face face = order->faces[f];
        for (std::uint32_t& corner : face) corner = prefix_corner(order->map, corner, N);
        ASSERT_LT(std::max({face[0], face[1], face[2]}), N);
        ASSERT_TRUE(face[0] != face[1] && face[1] != face[2] && face[2] != face[0]);
        faces.push_back(face);
      }
      if (!keeps_topology) continue;
      if (!characteristic) characteristic = testing::euler_characteristic(faces, N);
      EXPECT_EQ(testing::euler_characteristic(faces, N), *characteristic) << "N = " << N;
    }
    RecordProperty(std::filesystem::path(file).filename().string(), std::to_string(order->base_count));
  }
  EXPECT_GT(built, files.size() / 2);
}

}  // namespace
}  // namespace eigencast
