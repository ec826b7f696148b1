// SPDX-License-Identifier: MIT
// What a smooth basis leaves out, put back in six ways: Figure 10 of Zhang et al. 2013, "Streaming 3D Deforming
// Surfaces with Dynamic Resolution Control", and what else could be done at the same rate.
//   detail_methods RANK CLIP...        CLIP: a clip that eigencast-sender plays, or box: the bar of Table II at rest
// Prints CSV lines of three kinds: method,CLIP,METHOD,KG,RMS,MAX,KG AT REST; frame,CLIP,METHOD,FRAME,HAUSDORFF;
// height,CLIP,VERTEX,LENGTH. All but KG (percent) over the diagonal of the rest box; not quantised; MAX over vertices.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>

#include "bench/paper/deformation_transfer.h"
#include "common/surface/checks/surface_distance.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/asset_cache.h"
#include "sender/source.h"
#include "sender/surface_error.h"

using namespace eigencast;

namespace {

constexpr std::size_t kHeights = 200;  // vertices of which the displacement is stated

template <typename T>
T value_or_exit(Result<T> result) {
  if (result) return *std::move(result);
  std::fprintf(stderr, "detail_methods: %s\n", result.error().message.c_str());
  std::exit(1);
}

/// A surface in one basis.
class Received {
 public:
  Received(const Surface& surface, BasisKind basis, int rank, DetailKind detail = DetailKind::kNone)
      : asset_(std::make_unique<Asset>(
            value_or_exit(
                bake(surface, {.basis = basis, .rank = rank, .name = "detail", .detail = detail}, default_cache_dir()))
                .asset)),
        projector_(value_or_exit(Projector::create(*asset_))),
        rebuilder_(*asset_) {}
  std::vector<Vec3> of(std::span<const Vec3> pose) {
    const auto C = value_or_exit(
        projector_.coefficients_from_positions(std::span<const double>(pose.front().data(), 3 * pose.size())));
    const std::span<const Vec3> rebuilt = rebuilder_.rebuild(C, 3);
    return {rebuilt.begin(), rebuilt.end()};
  }
  double diagonal() const { return asset_->diagonal(); }
  const Asset& asset() const { return *asset_; }

 private:
  std::unique_ptr<Asset> asset_;
  Projector projector_;
  SourceRebuilder rebuilder_;
};

/// Symmetric, of vertices to triangles.
double hausdorff(std::span<const Vec3> a, SurfaceDistance& to_a, std::span<const Vec3> b, SurfaceDistance& to_b) {
  to_a.move_to(a);
  to_b.move_to(b);
  std::vector<double> bounds(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) bounds[i] = squared_distance(a[i], b[i]);
  return std::sqrt(farthest_squared(b, to_a, bounds, farthest_squared(a, to_b, bounds)));
}

/// A surface rebuilt in all ways.
class Methods {
 public:
  Methods(const Surface& rest, int rank)
      : rest_(rest),
        harmonic_(rest, BasisKind::kHarmonic, rank),
        augmented_(rest, BasisKind::kAugmented, rank),
        normal_(rest, BasisKind::kHarmonic, rank, DetailKind::kNormal),
        frames_(rest, BasisKind::kHarmonic, rank, DetailKind::kFrames),
        base_rest_(harmonic_.of(rest.positions)),
        transfer_(rest.positions, base_rest_, rest.faces) {}

  std::map<std::string, std::vector<Vec3>> of(std::span<const Vec3> pose) {
    std::map<std::string, std::vector<Vec3>> ways;
    const std::vector<Vec3> base = harmonic_.of(pose);
    ways["1 base only"] = base;
    std::vector<Vec3>& world = ways["2 world axes"] = base;
    for (std::size_t i = 0; i < world.size(); ++i) {
      for (std::size_t axis = 0; axis < 3; ++axis) world[i][axis] += rest_.positions[i][axis] - base_rest_[i][axis];
    }
    ways["3 normal (paper)"] = normal_.of(pose);
    ways["4 frames"] = frames_.of(pose);
    if (!transfer_.carry(base, ways["5 deformation transfer"])) {
      std::fprintf(stderr, "detail_methods: the Poisson system cannot be factored\n");
      std::exit(1);
    }
    ways["6 augmented"] = augmented_.of(pose);
    return ways;
  }
  double diagonal() const { return augmented_.diagonal(); }
  const Asset& normal() const { return normal_.asset(); }

 private:
  const Surface& rest_;
  Received harmonic_, augmented_, normal_, frames_;
  std::vector<Vec3> base_rest_;
  bench::DeformationTransfer transfer_;
};

/// Takes an asset with detail along normals.
void print_heights(const std::string& name, const Asset& normal) {
  std::vector<double> heights(normal.vertex_count);  // in the source's order
  for (std::size_t row = 0; row < heights.size(); ++row)
    heights[normal.source_vertex[row]] = std::abs(double{normal.detail.offset[row][2]}) / normal.diagonal();
  for (std::size_t k = 0; k < kHeights; ++k) {
    const std::size_t i = k * heights.size() / kHeights;
    std::printf("height,%s,%zu,%.4e\n", name.c_str(), i, heights[i]);
  }
}

void run(const std::string& name, const MotionClip& clip, int rank) {
  const Surface& rest = clip.rest();
  Methods methods(rest, rank);
  const double diagonal = methods.diagonal();
  SurfaceDistance to_truth(rest.positions, rest.faces), to_rebuilt(rest.positions, rest.faces);
  std::map<std::string, SurfaceErrorSum> sums, at_rest;
  for (const auto& [method, rebuilt] : methods.of(rest.positions))
    at_rest.try_emplace(method, diagonal).first->second.add(rest.positions, rebuilt);
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const std::vector<Vec3> truth = value_or_exit(clip.pose(frame));
    for (const auto& [method, rebuilt] : methods.of(truth)) {
      sums.try_emplace(method, diagonal).first->second.add(truth, rebuilt);
      std::printf("frame,%s,%s,%zu,%.4e\n", name.c_str(), method.c_str() + 2, frame,
                  hausdorff(truth, to_truth, rebuilt, to_rebuilt) / diagonal);
    }
  }
  for (const auto& [method, sum] : sums) {
    const SurfaceError error = sum.result();
    std::printf("method,%s,%s,%.3f,%.3e,%.3e,%.3f\n", name.c_str(), method.c_str() + 2, error.kg_percent, error.rms,
                error.max, at_rest.at(method).result().kg_percent);
  }
  print_heights(name, methods.normal());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return std::fprintf(stderr, "usage: detail_methods RANK CLIP...\n"), 2;
  const int rank = std::atoi(argv[1]);
  for (int i = 2; i < argc; ++i) {
    SourceOptions options;
    options.input = argv[i];
    if (options.input == "box") {
      const Surface bar = make_box(40, 185, 40, {1, 4.625, 1});
      print_heights("box", Received(bar, BasisKind::kHarmonic, rank, DetailKind::kNormal).asset());
      continue;
    }
    const auto clip = value_or_exit(open_source(options));
    run(options.input, *clip, rank);
  }
  return 0;
}
