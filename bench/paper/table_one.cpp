// SPDX-License-Identifier: MIT
//
// table_one NAME=SURFACE...: a line of CSV for each: how long the 200 lowest eigenpairs take of the mesh and of its
// vertices as points, the operator included, a whole bake, and one pose's transform and reconstruction (medians of 41).
// SURFACE as bench/named_surface.h has it.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "bench/named_surface.h"
#include "common/reconstruction/reconstruct.h"
#include "common/spectral/eigenbasis.h"
#include "sdk/bake.h"

namespace {

using namespace eigencast;

constexpr int kPairs = 200;

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

template <typename Work>
double median_seconds(const Work& work) {
  std::vector<double> seconds;
  for (int i = 0; i < 41; ++i) {
    const double begin = now();
    work();
    seconds.push_back(now() - begin);
  }
  std::nth_element(seconds.begin(), seconds.begin() + 20, seconds.end());
  return seconds[20];
}

double eigen_seconds(const Surface& surface) {
  const double begin = now();
  const auto laplacian = build_laplacian(surface);
  if (!laplacian) std::exit((std::fprintf(stderr, "%s\n", laplacian.error().message.c_str()), 1));
  const auto basis = solve_eigenbasis(*laplacian, kPairs);
  if (!basis || !basis->certified) std::exit((std::fprintf(stderr, "no certified eigenpairs\n"), 1));
  return now() - begin;
}

void row(const std::string& name, const std::string& source) {
  const Surface mesh = bench::named_surface(source);
  const double of_mesh = eigen_seconds(mesh);
  const double of_points = eigen_seconds(Surface{mesh.positions, {}});
  const double begin = now();
  const auto baked = bake(mesh, {}, "");
  const double whole = now() - begin;
  if (!baked) std::exit((std::fprintf(stderr, "%s\n", baked.error().message.c_str()), 1));
  auto projector = Projector::create(baked->asset);
  if (!projector) std::exit((std::fprintf(stderr, "%s\n", projector.error().message.c_str()), 1));
  std::vector<float> positions;
  for (const Vec3& p : mesh.positions) {
    for (const double x : p) positions.push_back(static_cast<float>(x));
  }
  std::vector<double> C;
  const double forward = median_seconds([&] { C = *projector->coefficients_from_positions(positions); });
  Reconstructor reconstructor;
  reconstructor.update(baked->asset);
  const double back =
      median_seconds([&] { reconstructor.rebuild(C, 3, baked->asset.rank, baked->asset.vertex_count, positions); });
  std::printf("%s,%zu,%zu,%.3f,%.3f,%.2f,%.5f,%.5f\n", name.c_str(), mesh.vertex_count(), mesh.faces.size(), of_mesh,
              of_points, whole, forward, back);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  std::puts("model,vertices,faces,eigen_mesh_s,eigen_points_s,bake_mesh_s,transform_s,reconstruction_s");
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    const auto equals = argument.find('=');
    if (equals == std::string::npos) return std::fprintf(stderr, "table_one: NAME=SURFACE, not %s\n", argv[i]), 2;
    row(argument.substr(0, equals), argument.substr(equals + 1));
  }
}
