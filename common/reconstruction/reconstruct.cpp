// SPDX-License-Identifier: MIT
#include "common/reconstruction/reconstruct.h"

#include <algorithm>
#include <cassert>

#include "common/core/worker_team.h"
#include "common/reconstruction/kernel.h"

namespace eigencast {
namespace {

// Multiplications below which waking other threads takes longer than they save.
constexpr std::size_t kWorthThreads = 10'000'000;
constexpr std::size_t kTilesPerTask = 16;

/// C as the kernel wants it: poses x rank x 3, in units of the tiles' entries.
std::vector<float> packed_coefficients(const BasisTiles& tiles, std::span<const PoseToRebuild> poses,
                                       std::uint32_t rank) {
  std::vector<float> packed;
  packed.reserve(poses.size() * rank * 3);
  for (const PoseToRebuild& pose : poses) {
    assert(pose.channels >= 3 && pose.C.size() >= std::size_t{rank} * pose.channels);
    for (std::uint32_t k = 0; k < rank; ++k) {
      for (std::size_t d = 0; d < 3; ++d) {
        packed.push_back(static_cast<float>(pose.C[std::size_t{k} * pose.channels + d] * tiles.scale(k)));
      }
    }
  }
  return packed;
}

}  // namespace

Reconstructor::Reconstructor(InstructionSet set, unsigned threads) : set_(set), threads_(threads) {}

void Reconstructor::rebuild(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N,
                            std::uint32_t first) const {
  if (first >= N) return;
  assert(N <= tiles_.rows() && rank <= tiles_.rank());
  const std::vector<float> C = packed_coefficients(tiles_, poses, rank);
  const kernel::Functions& functions = kernel::functions(set_);
  const auto rebuild_tiles = [&](std::size_t first_tile, std::size_t end_row) {
    const std::size_t first_row = first_tile * kernel::kTileRows;
    std::vector<float*> X;
    for (const PoseToRebuild& pose : poses) X.push_back(pose.positions.data() + 3 * first_row);
    functions.product(tiles_.view(first_tile, rank), end_row - first_row, C.data(), poses.size(), X.data());
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
