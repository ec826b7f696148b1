// SPDX-License-Identifier: MIT
#include "sender/deform/cage_deformer.h"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cmath>

#include "common/core/worker_team.h"
#include "sender/deform/cage.h"
#include "sender/deform/coordinates.h"

namespace eigencast::deform {
namespace {

constexpr std::size_t kMaxWeights = std::size_t{2} << 30 >> 3;
constexpr std::size_t kRowsPerTask = 64;

class CageDeformer final : public Deformer {
 public:
  CageDeformer(Surface cage, CageCoordinates coordinates, LinearMap map)
      : cage_(std::move(cage)), coordinates_(coordinates), map_(std::move(map)) {}
  std::span<const Vec3> handles() const override { return cage_.positions; }
  std::span<const Face> handle_faces() const override { return cage_.faces; }
  const LinearMap* linear_map() const override { return &map_; }
  std::vector<double> controls(std::span<const Vec3> moved) const override {
    assert(moved.size() == cage_.vertex_count());
    std::vector<double> y;
    y.reserve(3 * map_.controls);
    for (const Vec3& p : moved) y.insert(y.end(), p.begin(), p.end());
    if (coordinates_ == CageCoordinates::kMeanValue) return y;
    for (const Vec3& n : stretched_normals(cage_, moved)) y.insert(y.end(), n.begin(), n.end());
    return y;
  }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override { return applied(map_, controls(moved)); }

 private:
  Surface cage_;
  CageCoordinates coordinates_;
  LinearMap map_;
};

}  // namespace

std::vector<Vec3> applied(const LinearMap& map, std::span<const double> y) {
  assert(y.size() == 3 * map.controls);
  std::vector<Vec3> positions(map.vertices);
  worker_team().run((map.vertices + kRowsPerTask - 1) / kRowsPerTask, [&](std::size_t task) {
    const std::size_t end = std::min(map.vertices, (task + 1) * kRowsPerTask);
    for (std::size_t i = task * kRowsPerTask; i < end; ++i) {
      const double* row = &map.W[i * map.controls];
      Vec3 p{};
      for (std::size_t c = 0; c < map.controls; ++c) {
        for (std::size_t axis = 0; axis < 3; ++axis) p[axis] += row[c] * y[3 * c + axis];
      }
      positions[i] = p;
    }
  });
  return positions;
}

Result<std::unique_ptr<Deformer>> cage_deformer(const Surface& model, Surface cage, CageCoordinates coordinates,
                                                const std::function<bool(double)>& progress) {
  const bool is_green = coordinates == CageCoordinates::kGreen;
  const std::size_t n = model.vertex_count(), corners = cage.vertex_count();
  LinearMap map{n, corners + (is_green ? cage.faces.size() : 0), {}};
  if (map.controls > kMaxWeights / n) {
    return fail(ErrorCode::kTooLarge, std::to_string(n) + " vertices in a cage of " + std::to_string(corners) +
                                          " need more than 2 GiB of weights; take a coarser cage");
  }
  map.W.resize(n * map.controls);
  const std::size_t tasks = (n + kRowsPerTask - 1) / kRowsPerTask;
  // In rounds, so that the caller's thread reports progress.
  const std::size_t rounds = std::min<std::size_t>(tasks, 50);
  std::atomic<std::size_t> outside{0}, first_outside{n};
  for (std::size_t round = 0; round < rounds; ++round) {
    if (progress && !progress(static_cast<double>(round) / static_cast<double>(rounds)))
      return fail(ErrorCode::kCancelled, "stopped while the model was bound to its cage");
    const std::size_t first_task = tasks * round / rounds, last_task = tasks * (round + 1) / rounds;
    worker_team().run(last_task - first_task, [&](std::size_t task) {
      const std::size_t begin = (first_task + task) * kRowsPerTask;
      for (std::size_t i = begin; i < std::min(n, begin + kRowsPerTask); ++i) {
        const std::span<double> row(&map.W[i * map.controls], map.controls);
        if (!is_green) {
          mean_value_coordinates(cage, model.positions[i], row);
          continue;
        }
        green_coordinates(cage, model.positions[i], row.first(corners), row.subspan(corners));
        if (winding_number(cage, model.positions[i]) > 0.75) continue;
        ++outside;
        std::size_t known = first_outside;
        while (i < known && !first_outside.compare_exchange_weak(known, i)) {
        }
      }
    });
  }
  if (outside > 0) {
    return fail(ErrorCode::kInvalidArgument,
                std::to_string(outside) + " vertices of the model are not inside the cage, the first is number " +
                    std::to_string(first_outside) + "; use a larger cage, or mean value coordinates");
  }
  return std::unique_ptr<Deformer>(std::make_unique<CageDeformer>(std::move(cage), coordinates, std::move(map)));
}

}  // namespace eigencast::deform
