// SPDX-License-Identifier: MIT
#include "common/reconstruction/reconstruct.h"

#include <algorithm>
#include <cassert>
#include <optional>
#include <vector>

#include "common/core/worker_team.h"
#include "common/reconstruction/kernel.h"

namespace eigencast {
namespace {

// Multiplications below which waking other threads takes longer than they save.
constexpr std::size_t kWorthThreads = 20'000'000;
constexpr std::size_t kTilesPerTask = 4;

/// A pose's coefficients as the kernel wants them.
struct PackedPose {
  std::vector<float>
      C;  // x 3, in units of the tiles' entries, zero beyond the last of an odd count of integers' columns
  std::optional<WholeCoefficients> whole;
};

PackedPose packed(const BasisTiles& tiles, const PoseToRebuild& pose, std::uint32_t rank) {
  assert(pose.channels >= 3 && pose.C.size() >= std::size_t{rank} * pose.channels);
  PackedPose packed;
  packed.C.reserve(3 * (std::size_t{rank} + 1));
  packed.whole = tiles.whole_coefficients(pose.C, pose.channels, rank);
  for (std::uint32_t k = 0; k < rank; ++k) {
    for (std::size_t d = 0; d < 3; ++d) {
      packed.C.push_back(static_cast<float>(pose.C[std::size_t{k} * pose.channels + d] * tiles.scale(k)));
    }
  }
  packed.C.resize(packed.C.size() + 3);
  return packed;
}

}  // namespace

Reconstructor::Reconstructor(InstructionSet set, unsigned threads) : set_(set), threads_(threads) {}

void Reconstructor::rebuild(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N,
                            std::uint32_t first) const {
  if (first >= N) return;
  assert(N <= tiles_.rows() && rank <= tiles_.rank());
  std::vector<PackedPose> all;
  all.reserve(poses.size());
  for (const PoseToRebuild& pose : poses) all.push_back(packed(tiles_, pose, rank));
  const kernel::Functions& functions = kernel::functions(set_);
  const auto rebuild_tiles = [&](std::size_t first_tile, std::size_t end_row) {
    const std::size_t first_row = first_tile * kernel::kTileRows;
    std::vector<kernel::Pose> here(poses.size());
    for (std::size_t p = 0; p < poses.size(); ++p) {
      here[p].C = all[p].C.data();
      if (all[p].whole) {
        here[p].whole = all[p].whole->C.data();
        std::copy(all[p].whole->unit.begin(), all[p].whole->unit.end(), here[p].unit);
      }
      here[p].X = poses[p].positions.data() + 3 * first_row;
    }
    functions.product(tiles_.view(first_tile, rank), end_row - first_row, here.data(), here.size());
  };
  const std::size_t begin = first / kernel::kTileRows;
  const std::size_t rows = N - begin * kernel::kTileRows;
  if (threads_ == 1 || rows * rank * 3 * poses.size() < kWorthThreads) return rebuild_tiles(begin, N);
  constexpr std::size_t kRows = kTilesPerTask * kernel::kTileRows;
  worker_team().run((rows + kRows - 1) / kRows, [&](std::size_t task) {
    const std::size_t tile = begin + task * kTilesPerTask;
    rebuild_tiles(tile, std::min<std::size_t>(N, tile * kernel::kTileRows + kRows));
  });
}

void Reconstructor::rebuild(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
                            std::span<float> positions) const {
  const PoseToRebuild pose{C, channels, positions};
  rebuild({&pose, 1}, rank, N);
}

void positions_from_coefficients(const Asset& asset, std::span<const double> C, std::uint32_t channels,
                                 std::uint32_t rank, std::uint32_t N, std::span<float> positions) {
  assert(N <= asset.rows_ready);
  Reconstructor once;
  once.update(asset);
  once.rebuild(C, channels, rank, N, positions);
}

}  // namespace eigencast
