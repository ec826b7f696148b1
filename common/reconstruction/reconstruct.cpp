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

// Multiplications below which other threads cost more than they save.
constexpr std::size_t kWorthThreadsToRebuild = 20'000'000;
constexpr std::size_t kTilesPerTask = 4;

/// A pose's coefficients as the kernel reads them.
struct PackedPose {
  std::vector<float> C;  // x 3, in units of the tiles' entries; zero beyond the last column
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

/// The coefficients of some poses for one matrix.
class Packed {
 public:
  Packed(const BasisTiles& tiles, std::span<const PoseToRebuild> poses, std::uint32_t rank)
      : tiles_(tiles), rank_(rank) {
    for (const PoseToRebuild& pose : poses) poses_.push_back(packed(tiles, pose, rank));
  }
  /// The product with the rows from a tile on.
  ///   rooms  output of each pose
  void multiply(const kernel::Functions& functions, std::size_t first_tile, std::size_t rows,
                std::span<const std::span<float>> rooms) const {
    std::vector<kernel::Pose> here(poses_.size());
    for (std::size_t p = 0; p < poses_.size(); ++p) {
      here[p].C = poses_[p].C.data();
      if (poses_[p].whole) {
        here[p].whole = poses_[p].whole->C.data();
        std::copy(poses_[p].whole->unit.begin(), poses_[p].whole->unit.end(), here[p].unit);
      }
      here[p].X = rooms[p].data();
    }
    functions.product(tiles_.view(first_tile, rank_), rows, here.data(), here.size());
  }

 private:
  const BasisTiles& tiles_;
  std::uint32_t rank_;
  std::vector<PackedPose> poses_;
};

std::span<float> part_of(std::span<float> values, std::size_t row, std::size_t rows) {
  return values.empty() ? values : values.subspan(3 * row, 3 * rows);
}

}  // namespace

Reconstructor::Reconstructor(InstructionSet set, unsigned threads) : set_(set), threads_(threads) {}

void Reconstructor::update(const Asset& asset) {
  tiles_.update(asset);
  detail_.update(asset);
}

void Reconstructor::reset() {
  tiles_ = {};
  detail_ = {};
}

void Reconstructor::run(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N, std::uint32_t first,
                        bool with_detail) const {
  if (first >= N) return;
  assert(N <= tiles_.rows() && rank <= tiles_.rank());
  const Packed base(tiles_, poses, rank);
  std::vector<Packed> derivatives;
  if (with_detail) {
    derivatives.emplace_back(detail_.along_x(), poses, rank);
    derivatives.emplace_back(detail_.along_y(), poses, rank);
  }
  const kernel::Functions& functions = kernel::functions(set_);
  const auto rebuild_tiles = [&](std::size_t first_tile, std::size_t end_row) {
    const std::size_t row = first_tile * kernel::kTileRows, rows = end_row - row;
    std::vector<std::span<float>> rooms;
    for (const PoseToRebuild& pose : poses) rooms.push_back(part_of(pose.positions, row, rows));
    base.multiply(functions, first_tile, rows, rooms);
    if (!with_detail) return;
    std::vector<float> along(2 * poses.size() * 3 * rows);
    const auto room = [&](std::size_t axis, std::size_t p) {
      return part_of(along, (axis * poses.size() + p) * rows, rows);
    };
    for (std::size_t axis = 0; axis < 2; ++axis) {
      for (std::size_t p = 0; p < poses.size(); ++p) rooms[p] = room(axis, p);
      derivatives[axis].multiply(functions, first_tile, rows, rooms);
    }
    for (std::size_t p = 0; p < poses.size(); ++p) {
      detail_.add(static_cast<std::uint32_t>(row), room(0, p), room(1, p), part_of(poses[p].positions, row, rows),
                  part_of(poses[p].normals, row, rows));
    }
  };
  const std::size_t begin = first / kernel::kTileRows;
  const std::size_t rows = N - begin * kernel::kTileRows;
  constexpr std::size_t kRows = kTilesPerTask * kernel::kTileRows;
  const std::size_t tasks = (rows + kRows - 1) / kRows;
  const auto do_task = [&](std::size_t task) {
    const std::size_t tile = begin + task * kTilesPerTask;
    rebuild_tiles(tile, std::min<std::size_t>(N, tile * kernel::kTileRows + kRows));
  };
  const std::size_t multiplications = rows * rank * 3 * poses.size() * (with_detail ? 3 : 1);
  const bool alone = threads_ == 1 || multiplications < kWorthThreadsToRebuild;
  if (alone && !with_detail) {
    rebuild_tiles(begin, N);
  } else if (alone) {
    for (std::size_t task = 0; task < tasks; ++task) do_task(task);
  } else {
    worker_team().run(tasks, do_task);
  }
}

void Reconstructor::rebuild(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N,
                            std::uint32_t first) const {
  run(poses, rank, N, first, has_detail());
}

void Reconstructor::rebuild(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
                            std::span<float> positions) const {
  const PoseToRebuild pose{C, channels, positions};
  rebuild({&pose, 1}, rank, N);
}

void Reconstructor::combine(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
                            std::span<float> values) const {
  const PoseToRebuild pose{C, channels, values};
  run({&pose, 1}, rank, N, 0, false);
}

void positions_from_coefficients(const Asset& asset, std::span<const double> C, std::uint32_t channels,
                                 std::uint32_t rank, std::uint32_t N, std::span<float> positions) {
  assert(N <= asset.rows_ready);
  Reconstructor once;
  once.update(asset);
  once.combine(C, channels, rank, N, positions);
}

}  // namespace eigencast
