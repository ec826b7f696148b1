// SPDX-License-Identifier: MIT
#include "view/gpu_basis.h"

#include <array>

namespace eigencast {
namespace {

constexpr std::size_t kRows = kernel::kTileRows;
constexpr std::size_t kGroup = GpuBasis::kColumns;
static_assert(kGroup % 2 == 0, "groups hold whole pairs of columns");

constexpr std::size_t groups_of(std::size_t columns) {
  return (columns + kGroup - 1) / kGroup;
}

std::size_t padded_rows(const Asset& asset) {
  return (asset.vertex_count + kRows - 1) / kRows * kRows;
}

/// A tile's columns, in groups: group, row, column of the group.
template <typename Value, typename Index>
std::vector<Value> in_groups(const Value* columns, std::size_t count, const Index& index_of) {
  std::vector<Value> groups(groups_of(count) * kRows * kGroup);
  for (std::size_t k = 0; k < count; ++k) {
    Value* group = groups.data() + k / kGroup * kRows * kGroup + k % kGroup;
    for (std::size_t row = 0; row < kRows; ++row) group[row * kGroup] = columns[index_of(row, k)];
  }
  return groups;
}

}  // namespace

std::size_t GpuBasis::texels(const Asset& asset) {
  return padded_rows(asset) * (groups_of(asset.rank) + 1);
}

void GpuBasis::update(const Asset& asset, const BasisTiles& tiles) {
  append_discs(asset);
  const auto float_columns = static_cast<std::uint32_t>(tiles.view(0, tiles.rank()).float_columns);
  if (float_columns != float_columns_) rows_ = 0;  // some entry was off the grid: floats hold all
  if (tiles.rows() <= rows_) return;
  float_columns_ = float_columns;
  float_groups_ = static_cast<std::uint32_t>(groups_of(float_columns));
  integer_groups_ = static_cast<std::uint32_t>(groups_of(tiles.rank() - float_columns));
  const std::size_t rows = padded_rows(asset);
  floats_.reserve(rows * float_groups_ * kGroup * sizeof(float), GL_STATIC_DRAW);
  integers_.reserve(rows * integer_groups_ * kGroup * sizeof(std::int16_t), GL_STATIC_DRAW);
  for (std::size_t number = rows_ / kRows; number < tiles.tile_count(); ++number)
    append_tile(tiles.view(number, tiles.rank()), number);
  rows_ = tiles.rows();
}

void GpuBasis::append_tile(const kernel::Tiles& tile, std::size_t number) {
  const std::vector<float> floats = in_groups(tile.floats, tile.float_columns,
                                              [](std::size_t row, std::size_t column) { return column * kRows + row; });
  floats_.write(number * floats.size() * sizeof(float), std::span<const float>(floats));
  const std::vector<std::int16_t> integers = in_groups(tile.integers, tile.integer_columns, kernel::offset_of_integer);
  integers_.write(number * integers.size() * sizeof(std::int16_t), std::span<const std::int16_t>(integers));
}

void GpuBasis::append_discs(const Asset& asset) {
  const auto count = static_cast<std::uint32_t>(asset.splats.size());
  if (count <= discs_) return;
  std::vector<std::array<float, 4>> normals;
  for (std::uint32_t i = discs_; i < count; ++i) {
    const auto& n = asset.splats.normal[i];
    normals.push_back({n[0], n[1], n[2], 0});
  }
  constexpr std::size_t kFrame = sizeof(asset.splats.frame[0]), kNormal = sizeof(normals[0]);
  frames_.reserve(asset.vertex_count * kFrame, GL_STATIC_DRAW);
  disc_normals_.reserve(asset.vertex_count * kNormal, GL_STATIC_DRAW);
  frames_.write(discs_ * kFrame, std::span(asset.splats.frame).subspan(discs_));
  disc_normals_.write(discs_ * kNormal, std::span<const std::array<float, 4>>(normals));
  discs_ = count;
}

GpuBasis::Coefficients GpuBasis::pack(const BasisTiles& tiles, std::span<const double> C, std::uint32_t channels,
                                      std::uint32_t rank) {
  const kernel::Tiles columns = tiles.view(0, rank);
  Coefficients packed;
  packed.float_groups = static_cast<std::uint32_t>(groups_of(columns.float_columns));
  packed.integer_groups = static_cast<std::uint32_t>(groups_of(columns.integer_columns));
  packed.values.resize((packed.float_groups + packed.integer_groups) * std::size_t{3} * kGroup);
  for (std::uint32_t k = 0; k < rank; ++k) {
    const bool integer = k >= columns.float_columns;
    const std::size_t column = integer ? k - columns.float_columns : k;
    const std::size_t group = column / kGroup + (integer ? packed.float_groups : 0);
    const double scale = tiles.scale(k) * (integer ? kernel::kIntegerUnit : 1);
    for (std::size_t d = 0; d < 3; ++d) {
      packed.values[(3 * group + d) * kGroup + column % kGroup] =
          static_cast<float>(C[std::size_t{k} * channels + d] * scale);
    }
  }
  return packed;
}

}  // namespace eigencast
