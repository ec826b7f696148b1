// SPDX-License-Identifier: MIT
// Real files; the counts are those that the data's own description states, found there by other programs.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "common/surface/checks/check.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
const fs::path kData = data_dir();

std::vector<std::string> files_below(const std::string& folder) {
  std::vector<std::string> paths;
  for (const auto& entry : fs::directory_iterator(kData / folder)) paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end());
  return paths;
}

SurfaceReport report_of(const std::string& path) {
  const auto surface = read_surface((kData / path).string());
  EXPECT_TRUE(surface.has_value()) << surface.error().message;
  return surface ? check_surface(*surface) : SurfaceReport{};
}

// An independent reading: `v` lines as they stand and fans of `f` lines with plain positive indices.
Surface plain_obj(const std::string& path) {
  Surface s;
  std::ifstream in(path);
  std::string line;
  while (std::getline(in, line)) {
    std::istringstream words(line);
    std::string word;
    words >> word;
    if (word == "v") {
      Vec3 p{};
      words >> p[0] >> p[1] >> p[2];
      s.positions.push_back(p);
    } else if (word == "f") {
      std::vector<std::uint32_t> corners;
      while (words >> word) corners.push_back(static_cast<std::uint32_t>(std::stoul(word) - 1));
      for (std::size_t k = 2; k < corners.size(); ++k) s.faces.push_back({corners[0], corners[k - 1], corners[k]});
    }
  }
  return s;
}

TEST(Data, ObjFilesAreReadUnchanged) {
  std::size_t files = 0;
  for (const char* folder : {"meshes/clean", "meshes/nasty"}) {
    for (const std::string& path : files_below(folder)) {
      if (fs::path(path).extension() != ".obj") continue;
      const auto surface = read_surface(path);
      ASSERT_TRUE(surface.has_value()) << surface.error().message;
      const Surface plain = plain_obj(path);
      EXPECT_EQ(surface->positions, plain.positions) << path;
      EXPECT_EQ(surface->faces, plain.faces) << path;
      ++files;
    }
  }
  EXPECT_GE(files, 6u);
}

TEST(Data, CleanMeshesAreClosedManifoldsOfKnownGenus) {
  const std::pair<const char*, long> kGenus[] = {
      {"spot", 0},  {"goathead", 0}, {"human_man", 0}, {"nefertiti-lowres", 0},
      {"skull", 2}, {"boot", 12},    {"animal", 0},    {"ring", 1}};
  for (const auto& [name, genus] : kGenus) {
    if (!has_data(std::string("meshes/clean/") + name + ".obj")) continue;
    const SurfaceReport r = report_of(std::string("meshes/clean/") + name + ".obj");
    EXPECT_TRUE(r.closed()) << name;
    EXPECT_EQ(r.nonmanifold_vertices, 0u) << name;
    EXPECT_EQ(r.components, 1u) << name;
    EXPECT_EQ(static_cast<long>(r.vertices) - static_cast<long>(r.faces) / 2, 2 - 2 * genus) << name;
  }
}

TEST(Data, MadeMeshesHaveTheStatedFaults) {
  EIGENCAST_SKIP_WITHOUT("meshes/nasty/herd.obj");
  EXPECT_EQ(report_of("meshes/nasty/herd.obj").components, 3u);
  EXPECT_GT(report_of("meshes/nasty/holes.obj").boundary_loops, 10u);
  EXPECT_GT(report_of("meshes/nasty/turned.obj").misoriented_edges, 100u);
  EXPECT_GT(report_of("meshes/nasty/seam.obj").duplicate_vertices, 100u);
  const SurfaceReport odd = report_of("meshes/nasty/odd.obj");
  EXPECT_EQ(odd.nonmanifold_edges, 3u);
  EXPECT_EQ(odd.duplicate_faces, 1u);
  EXPECT_EQ(odd.degenerate_faces, 1u);
  EXPECT_EQ(odd.unreferenced_vertices, 1u);
}

TEST(Data, NastyMeshesHaveTheStatedFaults) {
  EIGENCAST_SKIP_WITHOUT("meshes/nasty/cow.obj");
  SurfaceReport r = report_of("meshes/nasty/cow.obj");
  EXPECT_EQ(r.vertices, 2903u);
  EXPECT_EQ(r.nonmanifold_vertices, 1u);
  r = report_of("meshes/nasty/teapot.obj");
  EXPECT_EQ(r.duplicate_vertices, 403u);
  EXPECT_EQ(r.nonmanifold_vertices, 38u);
  EXPECT_EQ(r.components, 4u);
  r = report_of("meshes/nasty/suzanne.obj");
  EXPECT_EQ(r.nonmanifold_edges, 1u);
  EXPECT_EQ(r.duplicate_faces, 1u);
  EXPECT_EQ(r.components, 3u);
  r = report_of("meshes/nasty/truck.obj");
  EXPECT_EQ(r.vertices, 2956u);
  EXPECT_EQ(r.components, 50u);
  EXPECT_EQ(r.nonmanifold_edges, 54u);
  EXPECT_EQ(r.boundary_edges, 1388u);
  r = report_of("meshes/nasty/human_neutral.obj");
  EXPECT_EQ(r.components, 3u);
  EXPECT_GT(r.boundary_edges, 0u);
  EXPECT_EQ(report_of("meshes/nasty/demosthenes-low-res.obj").boundary_loops, 1u);
  EXPECT_EQ(report_of("meshes/nasty/cgal_blobby-shuffled.off").misoriented_edges, 3069u);
  r = report_of("meshes/nasty/cgal_boeing.off");
  EXPECT_EQ(r.components, 122u);
  EXPECT_EQ(r.duplicate_vertices, 1477u);
  r = report_of("meshes/nasty/cgal_bones.off");
  EXPECT_EQ(r.components, 26u);
  EXPECT_TRUE(r.closed());
  r = report_of("meshes/nasty/cgal_degtri_sliding.off");
  EXPECT_EQ(r.faces, 8u);
  EXPECT_EQ(r.degenerate_faces, 4u);
  r = report_of("meshes/nasty/cgal_cube-ouvert.off");
  EXPECT_EQ(r.unreferenced_vertices, 1u);
  EXPECT_EQ(r.boundary_edges, 4u);
  EXPECT_EQ(report_of("meshes/nasty/cgal_prim.off").unreferenced_vertices, 3u);
  EXPECT_EQ(report_of("meshes/nasty/cgal_mpi.off").vertices, 90u);
  r = report_of("meshes/nasty/cgal_elephant-with-holes.off");
  EXPECT_EQ(r.boundary_edges, 1353u);
  EXPECT_EQ(r.duplicate_vertices, 65u);
}

TEST(Data, MalformedFilesAreRefusedByName) {
  std::size_t files = 0;
  for (const std::string& path : files_below("meshes/malformed")) {
    const auto surface = read_surface(path);
    ASSERT_FALSE(surface.has_value()) << path;
    EXPECT_EQ(surface.error().code, ErrorCode::kCorrupt) << surface.error().message;
    EXPECT_NE(surface.error().message.find(path), std::string::npos);
    ++files;
  }
  EXPECT_GE(files, 3u);
}

TEST(Data, Clouds) {
  if (!has_data("clouds/cgal_kitten_5k_normals.xyz")) {
    EXPECT_EQ(report_of("clouds/animal.xyz").vertices, 1740u);
    return;
  }
  EXPECT_EQ(report_of("clouds/cgal_kitten_5k_normals.xyz").vertices, 5210u);
  EXPECT_EQ(report_of("clouds/cgal_radar_21k.xyz").vertices, 20950u);
}

TEST(Data, AGaitOpensAsAClip) {
  const bool real = has_data("animations/horse-gallop");
  const std::string folder = gait_clip().parent_path().string();
  const auto clip = open_clip(folder + "/vertices.npy", {folder + "/rest.obj"});
  ASSERT_TRUE(clip.has_value()) << clip.error().message;
  const std::size_t frames = (*clip)->frame_count();
  EXPECT_EQ(frames, real ? 48u : 32u);
  const SurfaceReport r = check_surface((*clip)->rest());
  EXPECT_EQ(r.vertices, real ? 8431u : 1740u);
  EXPECT_EQ(r.faces, real ? 16843u : 3476u);
  EXPECT_EQ(r.boundary_edges, real ? 19u : 0u);
  const auto first = (*clip)->pose(0);
  ASSERT_TRUE(first.has_value());
  const double diagonal = bounding_box((*clip)->rest().positions).diagonal();
  for (std::size_t i = 0; i < first->size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      ASSERT_NEAR((*first)[i][c], (*clip)->rest().positions[i][c], 1e-5 * diagonal) << "rest.obj is frame 0";
    }
  }
  EXPECT_TRUE((*clip)->pose(frames - 1).has_value());
  const auto by_folder = open_clip(folder);
  ASSERT_TRUE(by_folder.has_value());
  EXPECT_EQ((*by_folder)->frame_count(), frames);
  EXPECT_EQ((*by_folder)->rest().faces, (*clip)->rest().faces);
}

}  // namespace
}  // namespace eigencast
