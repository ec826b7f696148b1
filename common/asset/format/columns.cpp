// SPDX-License-Identifier: MIT
#include "common/asset/format/columns.h"

#include <algorithm>
#include <cassert>
#include <string>
#include <utility>

#include "common/asset/asset_limits.h"
#include "common/asset/format/manifest.h"
#include "common/asset/tiles/basis_tile.h"
#include "common/asset/tiles/predictor.h"

namespace eigencast {
namespace {

Error corrupt_columns(const std::string& what) {
  return fail(ErrorCode::kCorrupt, "columns of an asset: " + what);
}

/// Each row is predicted from the one that it contracts to: an asset that is there has no other predictors any more.
Predictors parents_of(std::span<const std::uint32_t> map, std::uint32_t first, std::uint32_t end) {
  Predictors parents;
  for (std::uint32_t row = first; row < end; ++row) {
    if (map[row] < row) {
      parents.rows.push_back(map[row]);
      parents.weights.push_back(1 << Predictors::kOneBits);
    }
    parents.end_row();
  }
  return parents;
}

BasisBlock block_of(std::span<const std::uint32_t> chunk_ends, std::size_t chunk, std::uint32_t k,
                    std::span<const float> scales, const Predictors& predictors) {
  return {chunk == 0 ? 0 : chunk_ends[chunk - 1], chunk_ends[chunk], 0, k, 0, k, scales, predictors};
}

}  // namespace

Result<void> check_columns(const Asset& asset, std::size_t k) {
  const auto refuse = [](ErrorCode code, const char* why) {
    return fail(code, std::string("this surface takes no learnt columns: ") + why);
  };
  if (asset.band_ends.size() >= asset_limits::kMaxBands)
    return refuse(ErrorCode::kUnsupported, "its asset has all eight bands already");
  if (asset.detail.size() > 0) return refuse(ErrorCode::kUnsupported, "its detail belongs to the basis as it is");
  if (asset.rank + k > asset_limits::kMaxRank ||
      4 * std::uint64_t{asset.vertex_count} * (asset.rank + k) > asset_limits::kMaxDecodedBytes)
    return refuse(ErrorCode::kTooLarge, "its basis is as large as one may be");
  return {};
}

Result<EncodedColumns> encode_columns(const Asset& asset, const EncodedAsset& encoded, const ColumnValues& columns) {
  const auto k = static_cast<std::uint32_t>(columns.scales.size());
  if (k == 0 || k > ColumnsSection::kMaxColumns || columns.values.size() != std::size_t{asset.vertex_count} * k)
    return fail(ErrorCode::kInvalidArgument, "columns of an asset: 1 to 64, with a value for each vertex");
  for (const float scale : columns.scales) {
    if (!(scale > 0) || !asset_limits::is_column_scale(scale))
      return fail(ErrorCode::kInvalidArgument, "columns of an asset: a scale is out of range");
  }
  if (const auto able = check_columns(asset, k); !able) return able.error();
  auto manifest = read_manifest(encoded.manifest.bytes);
  if (!manifest) return manifest.error();
  if (find_columns(*manifest)) return fail(ErrorCode::kInvalidArgument, "columns of an asset: it has some already");
  std::vector<std::uint32_t> ends;
  for (const ChunkEntry& chunk : manifest->chunks) ends.push_back(chunk.end_row);
  EncodedColumns result;
  ByteWriter out(result.section.bytes);
  out.u8(static_cast<std::uint8_t>(k));
  for (const float scale : columns.scales) out.f32(scale);
  Bytes tiles;
  for (std::size_t chunk = 0; chunk < ends.size(); ++chunk) {
    const Predictors parents = parents_of(asset.map, chunk == 0 ? 0 : ends[chunk - 1], ends[chunk]);
    const Bytes tile = encode_basis(block_of(ends, chunk, k, columns.scales, parents), columns.values);
    out.u32(static_cast<std::uint32_t>(tile.size()));
    tiles.insert(tiles.end(), tile.begin(), tile.end());
  }
  out.bytes(tiles);
  result.section.id = sha256(result.section.bytes);
  manifest->sections.push_back({kColumnsSection, false, result.section.bytes.size(), result.section.id});
  result.manifest.bytes = write_manifest(*manifest);
  result.manifest.id = sha256(result.manifest.bytes);
  if (auto readable = read_manifest(result.manifest.bytes); !readable) return readable.error();
  return result;
}

Result<ColumnsSection> ColumnsSection::parse(ByteView bytes, std::span<const std::uint32_t> chunk_ends) {
  ColumnsSection section;
  ByteReader in(bytes);
  const std::size_t k = in.u8();
  if (in.failed() || k == 0 || k > kMaxColumns) return corrupt_columns("1 to 64 are allowed");
  if (in.remaining() < 4 * (k + chunk_ends.size())) return corrupt_columns("they end too early");
  const std::uint64_t taken = std::uint64_t{2} * k * (chunk_ends.empty() ? 0 : chunk_ends.back());
  const std::uint64_t allowed = asset_limits::kFreeGrowth + bytes.size() * asset_limits::kMaxExpansion;
  if (taken > allowed) {
    return fail(ErrorCode::kTooLarge, "columns of an asset: " + std::to_string(taken) + " bytes in memory, over the " +
                                          std::to_string(allowed) + " that their size allows");
  }
  for (std::size_t j = 0; j < k; ++j) {
    section.scales_.push_back(in.f32());
    if (!(section.scales_.back() > 0) || !asset_limits::is_column_scale(section.scales_.back()))
      return corrupt_columns("a scale is out of range");
  }
  std::uint64_t end = 0;
  for (std::size_t chunk = 0; chunk < chunk_ends.size(); ++chunk) section.tile_ends_.push_back(end += in.u32());
  if (end != in.remaining()) return corrupt_columns("their tiles do not fill them");
  const ByteView tiles = in.bytes(end);
  section.tiles_.assign(tiles.begin(), tiles.end());
  section.chunk_ends_.assign(chunk_ends.begin(), chunk_ends.end());
  return section;
}

void add_columns(Asset& asset, std::uint32_t k) {
  const std::size_t before = asset.column_scales.size(), after = before + k;
  asset.rank += k;
  asset.band_ends.push_back(asset.rank);
  asset.rest.resize(std::size_t{3} * asset.rank);
  asset.column_scales.resize(after);
  std::vector<std::int16_t> wider(asset.rows_ready * after);
  for (std::size_t row = 0; before > 0 && row < asset.rows_ready; ++row)
    std::copy_n(&asset.integers[row * before], before, &wider[row * after]);
  asset.integers = std::move(wider);
}

Result<void> ColumnsSection::widen(Asset& asset) const {
  if (const auto able = check_columns(asset, count()); !able) return able;
  add_columns(asset, count());
  std::copy(scales_.begin(), scales_.end(), asset.column_scales.end() - count());
  return {};
}

Result<void> ColumnsSection::read_chunk(std::size_t chunk, std::span<const std::uint32_t> map, Asset& asset) const {
  const std::uint32_t first = chunk == 0 ? 0 : chunk_ends_[chunk - 1], end = chunk_ends_[chunk];
  const std::size_t stride = asset.column_scales.size(), behind = stride - count();
  assert(map.size() >= end && asset.integers.size() >= std::size_t{end} * stride);
  const std::size_t begin = chunk == 0 ? 0 : tile_ends_[chunk - 1];
  std::vector<std::int16_t> columns(std::size_t{end} * count());
  for (std::size_t row = 0; row < first; ++row)
    std::copy_n(&asset.integers[row * stride + behind], count(), &columns[row * count()]);
  const Predictors parents = parents_of(map, first, end);
  const auto read = decode_basis(block_of(chunk_ends_, chunk, count(), scales_, parents),
                                 ByteView(tiles_).subspan(begin, tile_ends_[chunk] - begin), {{}, columns});
  if (!read) return in_context("columns of an asset", read.error());
  for (std::size_t row = first; row < end; ++row)
    std::copy_n(&columns[row * count()], count(), &asset.integers[row * stride + behind]);
  return {};
}

Result<Asset> with_columns(const Asset& asset, ByteView section, std::span<const std::uint32_t> chunk_ends) {
  assert(asset.complete() && !chunk_ends.empty() && chunk_ends.back() == asset.vertex_count);
  const auto parsed = ColumnsSection::parse(section, chunk_ends);
  if (!parsed) return parsed.error();
  Asset wider = asset;
  if (const auto able = parsed->widen(wider); !able) return able.error();
  for (std::size_t chunk = 0; chunk < chunk_ends.size(); ++chunk) {
    if (const auto read = parsed->read_chunk(chunk, wider.map, wider); !read) return read.error();
  }
  return wider;
}

}  // namespace eigencast
