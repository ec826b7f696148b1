// SPDX-License-Identifier: MIT
// Table II and Figure 2 of Zhang et al. 2013, "Streaming 3D Deforming Surfaces with Dynamic Resolution Control", again:
// a bar of 32,802 vertices, deformed by a cage with Green coordinates, sent with 200 coefficients an axis, as a mesh
// and as points.
//   table_two [PICTURE.png]
// The error is the symmetric Hausdorff distance between the vertices of the deformed and the rebuilt bar over the
// diagonal of the rest box. The paper states neither its bar's proportions nor its angles, nor what it divides by.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numeric>

#include "bench/paper/picture.h"
#include "common/spectral/point_operators.h"
#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "sdk/bake.h"
#include "sender/deform/cage.h"
#include "sender/deform/script.h"
#include "sender/source.h"
#include "sender/surface_error.h"

using namespace eigencast;
using namespace eigencast::deform;

namespace {

constexpr int kRank = 200;
constexpr std::size_t kNeighbours = 8;

double farthest(std::span<const Vec3> from, std::span<const Vec3> to) {
  const PointSet set{to};
  const KdTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  double largest = 0;
  for (const Vec3& p : from) {
    std::uint32_t index = 0;
    double squared = 0;
    tree.knnSearch(p.data(), 1, &index, &squared);
    largest = std::max(largest, squared);
  }
  return std::sqrt(largest);
}

double hausdorff(std::span<const Vec3> a, std::span<const Vec3> b) {
  return std::max(farthest(a, b), farthest(b, a));
}

/// What normals are made of: fans of neighbours round each vertex, fixed at rest, so that they keep their sign in every
/// pose.
class Normals {
 public:
  explicit Normals(const Surface& surface) : surface_(surface) {
    if (!surface.is_point_cloud()) return;
    const PointSet set{surface.positions};
    const KdTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(10));
    for (const Vec3& p : surface.positions) {
      std::array<std::uint32_t, kNeighbours + 1> near{};
      std::array<double, kNeighbours + 1> squared{};
      tree.knnSearch(p.data(), near.size(), near.data(), squared.data());
      fans_.push_back(fan(p, near));
    }
  }
  std::vector<Vec3> of(std::span<const Vec3> positions) const {
    std::vector<Vec3> normals(positions.size());
    for (const Face& f : surface_.faces) {
      const Vec3 n = cross(positions[f[1]] - positions[f[0]], positions[f[2]] - positions[f[0]]);
      for (const std::uint32_t v : f) normals[v] = normals[v] + n;
    }
    for (std::size_t i = 0; i < fans_.size(); ++i) {
      for (std::size_t k = 0; k < kNeighbours; ++k) {
        const Vec3 &a = positions[fans_[i][k]], &b = positions[fans_[i][(k + 1) % kNeighbours]];
        normals[i] = normals[i] + cross(a - positions[i], b - positions[i]);
      }
    }
    for (Vec3& n : normals) n = unit(n);
    return normals;
  }

 private:
  using Fan = std::array<std::uint32_t, kNeighbours>;
  /// The neighbours by their angle round the bar's outward direction, which for a convex body is that from its middle.
  Fan fan(const Vec3& p, const std::array<std::uint32_t, kNeighbours + 1>& near) const {
    const Vec3 out = unit({p[0], 0.05 * p[1], p[2]});
    const Vec3 u = unit(cross(out, std::abs(out[1]) < 0.9 ? Vec3{0, 1, 0} : Vec3{1, 0, 0})), v = cross(out, u);
    Fan sorted{};
    std::copy(near.begin() + 1, near.end(), sorted.begin());
    std::sort(sorted.begin(), sorted.end(), [&](std::uint32_t a, std::uint32_t b) {
      const auto angle = [&](std::uint32_t i) {
        const Vec3 d = surface_.positions[i] - p;
        return std::atan2(dot(d, v), dot(d, u));
      };
      return angle(a) < angle(b);
    });
    return sorted;
  }
  const Surface& surface_;
  std::vector<Fan> fans_;
};

/// The bar in one basis: what a receiver rebuilds of a pose.
class Received {
 public:
  /// motion: whose columns the basis is, all of them and exactly; null: 200 columns, as assets are stored by default.
  Received(const Surface& bar, BasisKind basis, const KnownMotion* motion = nullptr) {
    const int rank = motion != nullptr ? static_cast<int>(motion->columns.count) : kRank;
    const double asset_error = motion != nullptr ? 0 : 1e-4;
    const BakeOptions options{.basis = basis,
                              .rank = rank,
                              .name = "bar",
                              .asset_error = asset_error,
                              .motion = motion,
                              .detail = DetailKind::kNone};
    auto baked = bake(bar, options, "");
    if (!baked) {
      std::fprintf(stderr, "%s\n", baked.error().message.c_str());
      std::exit(1);
    }
    asset_ = std::make_unique<Asset>(std::move(baked->asset));
    projector_ = std::make_unique<Projector>(std::move(*Projector::create(*asset_)));
    rebuilder_ = std::make_unique<SourceRebuilder>(*asset_);
  }
  std::vector<Vec3> of(std::span<const Vec3> pose) {
    const auto C =
        projector_->coefficients_from_positions(std::span<const double>(pose.front().data(), 3 * pose.size()));
    const std::span<const Vec3> rebuilt = rebuilder_->rebuild(*C, 3);
    return {rebuilt.begin(), rebuilt.end()};
  }

 private:
  std::unique_ptr<Asset> asset_;
  std::unique_ptr<Projector> projector_;
  std::unique_ptr<SourceRebuilder> rebuilder_;
};

/// The paper's detail: at rest the distance of each vertex from the base model along its normal; in a pose the same
/// along the normal of the moved base.
std::vector<Vec3> displaced(const Surface& bar, const Normals& normals, std::span<const Vec3> base_rest,
                            std::vector<Vec3> base) {
  const std::vector<Vec3> n_rest = normals.of(base_rest), n = normals.of(base);
  for (std::size_t i = 0; i < base.size(); ++i) {
    base[i] = base[i] + dot(bar.positions[i] - base_rest[i], n_rest[i]) * n[i];
  }
  return base;
}

struct Row {
  const char* name;
  const char* script;
  double paper_mesh, paper_points;
};
constexpr Row kRows[] = {{"twist 180", "twist", 0.0032, 0.0029},
                         {"bend 180", "bend", 0.0093, 0.0101},
                         {"twist 90 + bend 90", "both", 0.0046, 0.0054}};

}  // namespace

int main(int argc, char** argv) {
  const Surface mesh = make_box(40, 185, 40, {1, 4.625, 1});
  const Surface cloud{mesh.positions, {}};
  const auto deformer = cage_deformer(mesh, make_box(1, 13, 1, {1.4, 5.0, 1.4}), CageCoordinates::kGreen);
  if (!deformer) return std::fprintf(stderr, "%s\n", deformer.error().message.c_str()), 1;
  const KnownMotion motion = motion_of_cage(**deformer);
  const double diagonal = bounding_box(mesh.positions).diagonal();
  bench::Sheet sheet(4, 3, 360, 420);

  std::printf(
      "| pose | | base model | with the paper's normal displacement | Eigencast (augmented) | Eigencast (the "
      "cage's basis) | the paper |\n|-|-|-|-|-|-|-|\n");
  for (const Surface* bar : {&mesh, &cloud}) {
    const bool is_mesh = bar == &mesh;
    const Normals normals(*bar);
    Received harmonic(*bar, BasisKind::kHarmonic), augmented(*bar, BasisKind::kAugmented),
        caged(*bar, BasisKind::kCage, &motion);
    const std::vector<Vec3> base_rest = harmonic.of(bar->positions);
    int row = 0;
    for (const Row& r : kRows) {
      const auto script = Script::builtin(r.script, (*deformer)->handles());
      const std::vector<Vec3> truth = (*deformer)->positions(script->handles_at(1));
      const std::vector<Vec3> base = harmonic.of(truth), ours = augmented.of(truth);
      std::printf("| %s | %s | %.4f | %.4f | %.4f | %.1e | %.4f |\n", r.name, is_mesh ? "mesh" : "points",
                  hausdorff(truth, base) / diagonal,
                  hausdorff(truth, displaced(*bar, normals, base_rest, base)) / diagonal,
                  hausdorff(truth, ours) / diagonal, hausdorff(truth, caged.of(truth)) / diagonal,
                  is_mesh ? r.paper_mesh : r.paper_points);
      const Vec3 centre{};
      const auto draw = [&](int column, const std::vector<Vec3>& positions) {
        sheet.draw(column, row, {positions, bar->faces}, normals.of(positions), 75, centre);
      };
      if (is_mesh) {
        draw(0, truth);
        draw(1, base);
        draw(2, ours);
      } else {
        draw(3, ours);
      }
      ++row;
    }
  }
  if (argc > 1 && !sheet.write_png(argv[1])) return std::fprintf(stderr, "%s: cannot be written\n", argv[1]), 1;
  return 0;
}
