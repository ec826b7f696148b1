// SPDX-License-Identifier: MIT
#include "sender/deform/arap.h"

#include <Eigen/Sparse>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cassert>
#include <numeric>
#include <utility>

#include "common/core/worker_team.h"
#include "common/surface/vector.h"
#include "sender/deform/rigidity.h"

namespace eigencast::deform {
namespace {

using Positions = Eigen::Matrix<double, Eigen::Dynamic, 3>;
using Sparse = Eigen::SparseMatrix<double>;

constexpr std::uint32_t kFree = ~0u;
constexpr std::size_t kVerticesPerTask = 256;

/// Or the number of vertices.
std::size_t unheld(const std::vector<std::vector<Neighbour>>& neighbours, const std::vector<std::uint32_t>& held) {
  std::vector<char> reached(held.size());
  std::vector<std::uint32_t> front;
  for (std::uint32_t v = 0; v < held.size(); ++v) {
    if (held[v] != kFree) reached[v] = 1, front.push_back(v);
  }
  while (!front.empty()) {
    const std::uint32_t v = front.back();
    front.pop_back();
    for (const Neighbour& n : neighbours[v]) {
      if (reached[n.vertex] == 0) reached[n.vertex] = 1, front.push_back(n.vertex);
    }
  }
  return static_cast<std::size_t>(std::find(reached.begin(), reached.end(), 0) - reached.begin());
}

Eigen::Vector3d eigen(const Vec3& p) {
  return {p[0], p[1], p[2]};
}

class ArapDeformer final : public Deformer {
 public:
  ArapDeformer(const Surface& model, std::vector<HandleGroup> groups, int iterations)
      : rest_(model.positions),
        groups_(std::move(groups)),
        iterations_(iterations),
        neighbours_(cotangent_neighbours(model.positions, model.faces)) {}

  Result<void> prepare();
  std::span<const Vec3> handles() const override { return handles_; }
  std::span<const Face> handle_faces() const override { return {}; }
  std::vector<Vec3> positions(std::span<const Vec3> moved) override;

 private:
  Eigen::Vector3d row(std::uint32_t v) const { return pose_.row(v).transpose(); }
  void fit_rotations();
  void fit_positions();

  std::vector<Vec3> rest_;
  std::vector<HandleGroup> groups_;
  int iterations_;
  std::vector<std::vector<Neighbour>> neighbours_;
  std::vector<Vec3> handles_;
  std::vector<std::uint32_t> held_;     ///< By vertex: its group, or kFree.
  std::vector<std::uint32_t> unknown_;  ///< By vertex: its row of the system, if free.
  std::vector<std::uint32_t> free_;     ///< Vertices by row.
  Eigen::SimplicialLDLT<Sparse> factor_;
  Positions pose_;  ///< n x 3, the last.
  std::vector<Eigen::Matrix3d> rotations_;
};

Result<void> ArapDeformer::prepare() {
  held_.assign(rest_.size(), kFree);
  handles_ = centres_of(groups_, rest_);
  for (std::uint32_t g = 0; g < groups_.size(); ++g) {
    for (const std::uint32_t v : groups_[g]) held_[v] = g;
  }
  if (const std::size_t v = unheld(neighbours_, held_); v < rest_.size()) {
    return fail(ErrorCode::kInvalidArgument,
                "the part of the model with vertex " + std::to_string(v) + " has no handle, so that nothing moves it");
  }
  unknown_.assign(rest_.size(), kFree);
  for (std::uint32_t v = 0; v < rest_.size(); ++v) {
    if (held_[v] == kFree) unknown_[v] = static_cast<std::uint32_t>(free_.size()), free_.push_back(v);
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (std::uint32_t i = 0; i < free_.size(); ++i) {
    double sum = 0;
    for (const Neighbour& n : neighbours_[free_[i]]) {
      sum += n.weight;
      if (unknown_[n.vertex] < i) entries.emplace_back(i, unknown_[n.vertex], -n.weight);
    }
    entries.emplace_back(i, i, sum);
  }
  Sparse L(static_cast<Eigen::Index>(free_.size()), static_cast<Eigen::Index>(free_.size()));
  L.setFromTriplets(entries.begin(), entries.end());
  factor_.compute(L);
  if (!free_.empty() && factor_.info() != Eigen::Success)
    return fail(ErrorCode::kNumerical, "the system of the handles could not be factored");
  pose_.resize(static_cast<Eigen::Index>(rest_.size()), 3);
  for (std::size_t v = 0; v < rest_.size(); ++v) pose_.row(static_cast<Eigen::Index>(v)) = eigen(rest_[v]).transpose();
  rotations_.assign(rest_.size(), Eigen::Matrix3d::Identity());
  return {};
}

void ArapDeformer::fit_rotations() {
  worker_team().run((rest_.size() + kVerticesPerTask - 1) / kVerticesPerTask, [&](std::size_t task) {
    const std::size_t end = std::min(rest_.size(), (task + 1) * kVerticesPerTask);
    for (std::size_t v = task * kVerticesPerTask; v < end; ++v) {
      Eigen::Matrix3d S = Eigen::Matrix3d::Zero();
      for (const Neighbour& n : neighbours_[v]) {
        S += n.weight * eigen(rest_[n.vertex] - rest_[v]) *
             (pose_.row(n.vertex) - pose_.row(static_cast<Eigen::Index>(v)));
      }
      rotations_[v] = best_rotation(S);
    }
  });
}

void ArapDeformer::fit_positions() {
  Positions right(static_cast<Eigen::Index>(free_.size()), 3);
  for (std::size_t i = 0; i < free_.size(); ++i) {
    const std::uint32_t v = free_[i];
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Neighbour& n : neighbours_[v]) {
      sum += 0.5 * n.weight * (rotations_[v] + rotations_[n.vertex]) * eigen(rest_[v] - rest_[n.vertex]);
      if (held_[n.vertex] != kFree) sum += n.weight * row(n.vertex);
    }
    right.row(static_cast<Eigen::Index>(i)) = sum.transpose();
  }
  const Positions solved = factor_.solve(right);
  for (std::size_t i = 0; i < free_.size(); ++i) pose_.row(free_[i]) = solved.row(static_cast<Eigen::Index>(i));
}

std::vector<Vec3> ArapDeformer::positions(std::span<const Vec3> moved) {
  assert(moved.size() == handles_.size());
  for (std::uint32_t g = 0; g < groups_.size(); ++g) {
    const Vec3 shift = moved[g] - handles_[g];
    for (const std::uint32_t v : groups_[g]) pose_.row(v) = eigen(rest_[v] + shift).transpose();
  }
  for (int i = 0; i < iterations_ && !free_.empty(); ++i) {
    fit_rotations();
    fit_positions();
  }
  std::vector<Vec3> positions(rest_.size());
  for (std::size_t v = 0; v < rest_.size(); ++v) {
    for (std::size_t c = 0; c < 3; ++c)
      positions[v][c] = pose_(static_cast<Eigen::Index>(v), static_cast<Eigen::Index>(c));
  }
  return positions;
}

}  // namespace

Result<void> check_handles(const std::vector<HandleGroup>& groups, std::size_t vertices, std::size_t faces) {
  if (faces == 0)
    return fail(ErrorCode::kUnsupported, "handles need a mesh: a point cloud has no neighbours; use a cage");
  if (groups.empty()) return fail(ErrorCode::kInvalidArgument, "no handles are given");
  std::vector<char> taken(vertices);
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const auto wrong = [&](const std::string& what) {
      return fail(ErrorCode::kInvalidArgument, "handle " + std::to_string(g) + ": " + what);
    };
    if (groups[g].empty()) return wrong("holds no vertex");
    for (const std::uint32_t v : groups[g]) {
      if (v >= vertices) return wrong("vertex " + std::to_string(v) + " is not in the model");
      if (std::exchange(taken[v], 1) != 0) return wrong("vertex " + std::to_string(v) + " has a handle already");
    }
  }
  return {};
}

std::vector<Vec3> centres_of(const std::vector<HandleGroup>& groups, std::span<const Vec3> positions) {
  std::vector<Vec3> centres;
  for (const HandleGroup& group : groups) {
    Vec3 sum{};
    for (const std::uint32_t v : group) sum = sum + positions[v];
    centres.push_back((1.0 / static_cast<double>(group.size())) * sum);
  }
  return centres;
}

Result<std::unique_ptr<Deformer>> arap_deformer(const Surface& model, std::vector<HandleGroup> groups, int iterations) {
  assert(iterations >= 1 && iterations <= 100);
  if (const auto usable = check_handles(groups, model.vertex_count(), model.faces.size()); !usable)
    return usable.error();
  auto deformer = std::make_unique<ArapDeformer>(model, std::move(groups), iterations);
  if (const auto ready = deformer->prepare(); !ready) return ready.error();
  return std::unique_ptr<Deformer>(std::move(deformer));
}

}  // namespace eigencast::deform
