// SPDX-License-Identifier: MIT
#include "common/spectral/point_operators.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "common/core/histogram.h"
#include "common/core/worker_team.h"

namespace eigencast {
namespace {

constexpr std::size_t kSpacingOf = 6;        // nearest points
constexpr std::size_t kMaxNeighbours = 192;  // an even cloud has 110 to 150 within the kernel
constexpr double kCut = 9.210340371976184;   // -ln 1e-4
constexpr double kMinWeight = 1e-7;  // a hundredth of the least on an even cloud; below it points count as apart
constexpr std::size_t kPointsAtOnce = 1024;  // per thread

using Pair = PointKernel::Pair;

/// Points that are not copies of others, and their indices in the cloud.
struct Distinct {
  std::vector<std::uint32_t> index;
  std::vector<Vec3> positions;
};

Distinct distinct_points(std::span<const Vec3> positions, const LocalTriangles& local) {
  std::vector<char> is_copy(positions.size(), 0);
  for (const auto& [copy, leader] : local.coincident) is_copy[copy] = 1;
  Distinct distinct;
  for (std::uint32_t i = 0; i < positions.size(); ++i) {
    if (is_copy[i] != 0) continue;
    distinct.index.push_back(i);
    distinct.positions.push_back(positions[i]);
  }
  return distinct;
}

std::vector<double> spacings(const KdTree& tree, std::span<const Vec3> positions) {
  std::vector<double> spacing(positions.size());
  for_shares(positions.size(), kPointsAtOnce, [&](std::size_t first, std::size_t end) {
    std::array<std::uint32_t, kSpacingOf + 1> found{};  // itself among them
    std::array<double, kSpacingOf + 1> squared{};
    for (std::size_t i = first; i < end; ++i) {
      const std::size_t count = tree.knnSearch(positions[i].data(), found.size(), found.data(), squared.data());
      double sum = 0;
      for (std::size_t j = 0; j < count; ++j) sum += std::sqrt(squared[j]);
      spacing[i] = count > 1 ? sum / static_cast<double>(count - 1) : 0;
    }
  });
  return spacing;
}

/// Cell areas. An open cell gets the usual area at the spacing of its neighbours: its own spacing would give a lone
/// point more weight than all others.
std::vector<double> areas(const Distinct& distinct, const KdTree& tree, std::span<const double> cell,
                          std::span<const double> spacing) {
  std::vector<double> area(spacing.size());
  std::vector<double> of_square;
  for (std::size_t i = 0; i < area.size(); ++i) {
    area[i] = cell[distinct.index[i]];
    if (area[i] > 0) of_square.push_back(area[i] / (spacing[i] * spacing[i]));
  }
  const double usual = of_square.empty() ? 1 : median(std::move(of_square));
  std::array<std::uint32_t, kSpacingOf + 1> found{};
  std::array<double, kSpacingOf + 1> squared{};
  for (std::size_t i = 0; i < area.size(); ++i) {
    if (area[i] > 0) continue;
    const std::size_t count = tree.knnSearch(distinct.positions[i].data(), found.size(), found.data(), squared.data());
    std::vector<double> nearby;
    for (std::size_t k = 0; k < count; ++k) nearby.push_back(spacing[found[k]]);
    area[i] = usual * std::pow(median(std::move(nearby)), 2);
  }
  return area;
}

}  // namespace

PointKernel point_kernel(std::span<const Vec3> positions, const LocalTriangles& local) {
  const Distinct distinct = distinct_points(positions, local);
  const std::size_t n = distinct.positions.size();
  const PointSet points{distinct.positions};
  const KdTree tree(3, points);
  const std::vector<double> spacing = spacings(tree, distinct.positions);
  const std::vector<double> area = areas(distinct, tree, local.cell, spacing);

  std::vector<std::vector<Pair>> parts((n + kPointsAtOnce - 1) / kPointsAtOnce);
  for_shares(n, kPointsAtOnce, [&](std::size_t first, std::size_t end) {
    std::vector<Pair>& pairs = parts[first / kPointsAtOnce];
    std::vector<std::uint32_t> found(std::min(kMaxNeighbours + 1, n));
    std::vector<double> squared(found.size());
    for (std::size_t i = first; i < end; ++i) {
      const std::size_t count =
          tree.knnSearch(distinct.positions[i].data(), found.size(), found.data(), squared.data());
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t j = found[k];
        const double t = spacing[i] * spacing[j];
        if (j == i || !(squared[k] < 4 * t * kCut)) continue;
        const double weight = area[i] / t * (area[j] / t) * std::exp(-squared[k] / (4 * t)) / (4 * std::numbers::pi);
        if (weight < kMinWeight) continue;  // so that bridges find it
        const auto [a, b] = std::minmax(distinct.index[i], distinct.index[j]);
        pairs.push_back({a, b, weight});
      }
    }
  });

  // Mutual neighbours give their pair twice.
  PointKernel kernel;
  std::size_t total = 0;
  for (const auto& part : parts) total += part.size();
  kernel.pairs.reserve(total);
  for (auto& part : parts) {
    kernel.pairs.insert(kernel.pairs.end(), part.begin(), part.end());
    part = {};
  }
  const auto ends = [](const Pair& pair) { return std::pair(pair.a, pair.b); };
  std::sort(kernel.pairs.begin(), kernel.pairs.end(), [&](const Pair& p, const Pair& q) { return ends(p) < ends(q); });
  const auto same = [&](const Pair& p, const Pair& q) { return ends(p) == ends(q); };
  kernel.pairs.erase(std::unique(kernel.pairs.begin(), kernel.pairs.end(), same), kernel.pairs.end());
  kernel.area.assign(positions.size(), 0);
  for (std::size_t i = 0; i < n; ++i) kernel.area[distinct.index[i]] = area[i];
  return kernel;
}

}  // namespace eigencast
