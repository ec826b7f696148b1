// SPDX-License-Identifier: MIT
#include "sdk/bake_parts.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "common/core/text.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/appearance.h"
#include "common/surface/checks/check.h"

namespace eigencast {
namespace {

/// Compares the rest pose with what receivers rebuild, over the box's diagonal.
double worst_rest_error(const Surface& surface, const Asset& asset) {
  Reconstructor receiver;
  receiver.update(asset);
  std::vector<float> rest(std::size_t{3} * asset.vertex_count);
  receiver.rebuild(asset.rest, 3, asset.rank, asset.vertex_count, rest);
  double worst = 0;
  for (std::size_t row = 0; row < asset.vertex_count; ++row) {
    const Vec3& truth = surface.positions[asset.source_vertex[row]];
    double squared = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double off = double{rest[3 * row + axis]} + asset.origin[axis] - truth[axis];
      squared += off * off;
    }
    worst = std::max(worst, std::sqrt(squared));
  }
  const double diagonal = asset.diagonal();
  return diagonal > 0 ? worst / diagonal : worst;
}

std::string report_of_detail(const EncodedAsset& encoded, const Asset& asset) {
  if (asset.detail.size() == 0) return {};
  return formatted("detail: %s; %.0f %% of the asset, and viewers multiply three times as much for a pose\n",
                   asset.detail.axes == 1 ? "along normals" : "in frames that turn with the surface",
                   100 * static_cast<double>(encoded.detail_bytes()) / static_cast<double>(encoded.total_bytes()));
}

std::string quality_of(const Basis& basis, BasisKind kind) {
  if (is_of_motion(kind)) {
    std::string line;
    if (is_of_columns(kind)) line = formatted(" of the %d that hold all of its motion", basis.dimensions);
    if (basis.rms.size() > 0) line += formatted("; leaves out %.2g %% of the poses' extent", 100 * basis.left_out);
    return line + "\n";
  }
  if (!basis.approximate) {
    return formatted("; eigenvectors %s, residual %.1e\n", basis.certified ? "complete" : "NOT certified complete",
                     basis.residual);
  }
  std::string missed = "those passed over not counted";
  if (basis.missed) missed = *basis.missed == 0 ? "none passed over" : formatted("%d passed over", *basis.missed);
  return formatted("; eigenvectors approximate, as of this many vertices: largest relative residual %.2f, %s\n",
                   basis.residual, missed.c_str());
}

}  // namespace

std::string report_of(const BakeResult& result, const BakeFacts& facts) {
  const auto& [surface, poses, options, laplacian, basis, seconds, bytes] = facts;
  std::string report = text_from_report(check_surface(surface));
  if (!report.empty() && report.back() != '\n') report += '\n';
  if (laplacian.components > 1) {
    report +=
        formatted("operator: %d separate pieces, joined by %d springs\n", laplacian.components, laplacian.bridges);
  }
  if (laplacian.flips)
    report += formatted("operator: Delaunay triangles of the tufted cover, %zu edges flipped\n", *laplacian.flips);
  if (options.points_operator == PointsOperator::kPbMhb) {
    report += formatted("operator: heat kernel between points (PB-MHB), %.0f entries a row\n",
                        static_cast<double>(laplacian.L.nonZeros()) / static_cast<double>(surface.vertex_count()));
  }
  report += formatted("basis: %s, rank %u", name_of(options.basis).data(), result.asset.rank);
  if (!is_of_motion(options.basis) && static_cast<int>(result.asset.rank) < options.rank) {
    report += formatted(" (%d asked for: the surface has too few vertices)", options.rank);
  }
  report += quality_of(basis, options.basis);
  report += formatted("rest pose: worst error %.1e of the box's diagonal\n", worst_rest_error(surface, result.asset));
  report += report_of_detail(result.encoded, result.asset);
  report += formatted("levels of detail: %u to %u vertices", result.asset.base_count, result.asset.vertex_count);
  if (poses > 0) report += formatted(", made for the rest pose and %zu more", poses);
  if (const auto& errors = result.asset.level_errors; !errors.empty())
    report += formatted("; %.2g %% of the diagonal off (rms) at the fewest", 100 * double{errors.front().rms});
  report += '\n';
  if (!result.asset.colours.empty()) report += "colours: one for each vertex\n";
  if (const auto& own = result.asset.normals; !own.empty())
    report +=
        formatted("normals: the file's own, hard at %td of %zu vertices\n",
                  std::count(own.begin(), own.end(), static_cast<std::uint8_t>(VertexNormals::kDiffer)), own.size());
  report += formatted("asset: %.2f MB in %zu chunks, id %s\n", static_cast<double>(result.encoded.total_bytes()) / 1e6,
                      result.encoded.chunks.size(), result.encoded.manifest.id.hex().c_str());
  report += formatted("baked in %.1f s, with about %.0f MB of memory\n", seconds, bytes / 1e6);
  return report;
}

}  // namespace eigencast
