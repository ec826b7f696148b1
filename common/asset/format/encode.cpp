// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "common/asset/asset.h"
#include "common/asset/asset_limits.h"
#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/tiles/basis_tile.h"
#include "common/asset/tiles/predictor.h"
#include "common/asset/tiles/tiles.h"
#include "common/core/bands.h"
#include "common/core/worker_team.h"

namespace eigencast {
namespace {

/// Moves each corner to the vertex that represents it with N vertices.
void move_to_level(std::span<const std::uint32_t> map, std::uint32_t N, std::span<Corners> faces) {
  for (Corners& face : faces) {
    for (std::uint32_t& corner : face) {
      while (corner >= N) corner = map[corner];
    }
  }
}

/// The first chunk holds the base and at least `first` rows, each later one as many as came before it, up to what keeps
/// a chunk near kTargetChunkBytes.
std::vector<std::uint32_t> chunk_ends(const Asset& asset, std::uint32_t first) {
  const std::uint64_t row_bytes = std::uint64_t{asset.rank} * (asset.detail.size() > 0 ? 6 : 2) + 24;
  const std::uint64_t most = std::max<std::uint64_t>(asset_limits::kTargetChunkBytes / row_bytes, 1024);
  std::vector<std::uint32_t> ends;
  std::uint64_t end = std::max<std::uint64_t>({first, asset.base_count, 1});
  while (end < asset.vertex_count) {
    ends.push_back(static_cast<std::uint32_t>(end));
    end += std::min(end, most);
  }
  ends.push_back(asset.vertex_count);
  return ends;
}

/// Columns add equally to the error: sum_k (amplitude_k step_k)^2 / 12 = error^2.
std::vector<double> steps_of(const AssetEncoding& encoding, std::uint32_t rank) {
  if (encoding.amplitudes.size() != rank || !(encoding.error > 0)) return {};
  std::vector<double> steps;
  for (const double amplitude : encoding.amplitudes) {
    steps.push_back(encoding.error * std::sqrt(12.0 / rank) / std::max(amplitude, 1e-30));
  }
  return steps;
}

/// Psi, n x r, of an asset that has integers; nothing where its floats are all.
std::vector<float> floats_of(const Asset& asset) {
  if (asset.column_scales.empty()) return {};
  std::vector<float> basis(std::size_t{asset.vertex_count} * asset.rank);
  for (std::size_t i = 0; i < asset.vertex_count; ++i)
    asset.copy_row(i, std::span(basis).subspan(i * asset.rank, asset.rank));
  return basis;
}

class Encoder {
 public:
  Encoder(const Asset& asset, const AssetEncoding& encoding)
      : asset_(asset), encoding_(encoding), copied_(floats_of(asset)) {
    basis_ = copied_.empty() ? asset.floats : copied_;
    manifest_.facts = asset;
    manifest_.exact_columns = std::min(encoding.exact_columns, asset.rank);
    manifest_.column_scales =
        column_scales_from_basis(basis_, asset.rank, manifest_.exact_columns, steps_of(encoding, asset.rank));
    predictors_ = choose_predictors(asset, manifest_.exact_columns, manifest_.column_scales);
    if (asset.detail.size() > 0) {
      detail_ = detail_on_basis(asset, on_grid(basis_, asset.rank, manifest_.exact_columns, manifest_.column_scales));
    }
  }

  Result<EncodedAsset> encode() {
    const std::vector<std::uint32_t> ends = chunk_ends(asset_, encoding_.first_chunk_rows);
    if (ends.size() > asset_limits::kMaxChunks)
      return fail(ErrorCode::kTooLarge, "asset: it would need more than 4096 chunks");
    std::vector<NewTile> basis = basis_tiles(ends);
    EncodedAsset encoded;
    for (std::size_t c = 0; c < ends.size(); ++c) {
      encoded.chunks.push_back(encode_chunk(ends[c], std::span(basis).subspan(c * bands(), bands())));
    }
    encoded.manifest.bytes = write_manifest(manifest_);
    encoded.manifest.id = sha256(encoded.manifest.bytes);
    // What readers would refuse (a chunk over the limits, say) is an error here, not a surprise there.
    if (auto readable = read_manifest(encoded.manifest.bytes); !readable) return readable.error();
    return encoded;
  }

 private:
  struct NewTile {
    TileEntry entry;
    Bytes bytes;
  };

  std::size_t bands() const { return asset_.band_ends.size(); }

  /// Lists each band of each chunk. The last are the largest and begin first, so that no thread ends alone with one.
  std::vector<NewTile> basis_tiles(std::span<const std::uint32_t> ends) const {
    std::vector<Predictors> predictors;
    for (std::size_t c = 0; c < ends.size(); ++c) {
      predictors.push_back(part_of(predictors_, c == 0 ? 0 : ends[c - 1], ends[c]));
    }
    std::vector<NewTile> tiles(ends.size() * bands());
    worker_team().run(tiles.size(), [&](std::size_t task) {
      const std::size_t at = tiles.size() - 1 - task, c = at / bands(), b = at % bands();
      const auto [first_column, end_column] = band_range(asset_.band_ends, b);
      const BasisBlock block{
          c == 0 ? 0 : ends[c - 1], ends[c],      first_column, end_column, manifest_.exact_columns, asset_.rank,
          manifest_.column_scales,  predictors[c]};
      tiles[at] = tile_of(TileKind::kBasis, b, encode_basis(block, basis_));
    });
    return tiles;
  }

  AssetObject encode_chunk(std::uint32_t end_row, std::span<NewTile> basis) {
    const ChunkRange range{row_, end_row, asset_.base_count, asset_.vertex_count};
    const auto end_death = std::lower_bound(asset_.death.begin(), asset_.death.end(), end_row);
    const auto end_face = static_cast<std::uint32_t>(end_death - asset_.death.begin());
    ChunkEntry entry;
    entry.end_row = end_row;
    entry.end_face = end_face;
    AssetObject object;
    const Predictors predictors = part_of(predictors_, row_, end_row);
    std::vector<NewTile> tiles{tile_of(TileKind::kStructure, 0, structure(range, end_face, predictors))};
    std::move(basis.begin(), basis.end(), std::back_inserter(tiles));
    add_extras(end_row, tiles);
    for (const NewTile& tile : tiles) {
      object.bytes.insert(object.bytes.end(), tile.bytes.begin(), tile.bytes.end());
      entry.tiles.push_back(tile.entry);
    }
    object.id = entry.id = sha256(object.bytes);
    manifest_.chunks.push_back(std::move(entry));
    row_ = end_row;
    return object;
  }

  /// Afterwards faces_ holds all faces up to end_face at level range.end_row.
  Bytes structure(const ChunkRange& range, std::uint32_t end_face, const Predictors& predictors) {
    const auto part = [&](const auto& all) {
      return std::vector(all.begin() + range.first_row, all.begin() + range.end_row);
    };
    StructureTile tile;
    tile.map = part(asset_.map);
    tile.source_vertex = part(asset_.source_vertex);
    tile.mass = part(asset_.mass);
    tile.predictors = predictors;
    const auto old_count = static_cast<std::ptrdiff_t>(faces_.size());
    std::vector<Corners> now(asset_.faces.begin(), asset_.faces.begin() + end_face);
    move_to_level(asset_.map, range.end_row, now);
    tile.old_faces.assign(now.begin(), now.begin() + old_count);
    tile.faces.assign(now.begin() + old_count, now.end());
    tile.death.assign(asset_.death.begin() + old_count, asset_.death.begin() + end_face);
    Bytes coded = encode_structure(range, tile,
                                   {std::span(asset_.source_vertex).first(range.first_row),
                                    std::span(asset_.mass).first(range.first_row), faces_});
    faces_ = std::move(now);
    return coded;
  }

  void add_extras(std::uint32_t end_row, std::vector<NewTile>& tiles) const {
    if (asset_.splats.size() > 0) {
      tiles.push_back(tile_of(TileKind::kSplats, 0,
                              encode_splats(asset_.splats, row_, end_row, asset_.base_count, asset_.diagonal())));
    }
    const auto map = std::span(asset_.map).subspan(row_, end_row - row_);
    if (detail_.size() > 0) tiles.push_back(tile_of(TileKind::kDetail, 0, encode_detail(detail_, row_, map)));
    if (!asset_.colours.empty()) {
      tiles.push_back(tile_of(TileKind::kColours, 0, encode_colours(asset_.colours, row_, map)));
    }
    if (!asset_.normals.empty()) {
      tiles.push_back(tile_of(TileKind::kNormals, 0, encode_normals(asset_.normals, row_, map)));
    }
    if (asset_.texture && end_row == asset_.vertex_count) {
      tiles.push_back(tile_of(TileKind::kUvs, 0, encode_uvs(*asset_.texture, asset_)));
      tiles.push_back(tile_of(TileKind::kImage, 0, asset_.texture->image));
    }
  }

  static NewTile tile_of(TileKind kind, std::size_t index, Bytes bytes) {
    TileEntry entry;
    entry.kind = static_cast<std::uint8_t>(kind);
    entry.index = static_cast<std::uint8_t>(index);
    entry.required = kind == TileKind::kStructure || kind == TileKind::kBasis;
    entry.bytes = static_cast<std::uint32_t>(std::min<std::size_t>(bytes.size(), 0xffffffff));  // Over all limits then.
    entry.hash = sha256(bytes);
    return {entry, std::move(bytes)};
  }

  const Asset& asset_;
  AssetEncoding encoding_;
  Manifest manifest_;
  std::vector<float> copied_;
  std::span<const float> basis_;  // n x r
  Predictors predictors_;
  Asset::Detail detail_;  // of the basis that readers have
  std::uint32_t row_ = 0;
  std::vector<Corners> faces_;  // of the chunks so far, at their last level
};

}  // namespace

std::size_t EncodedAsset::total_bytes() const {
  std::size_t sum = manifest.bytes.size();
  for (const auto* parts : {&chunks, &sections}) {
    for (const AssetObject& part : *parts) sum += part.bytes.size();
  }
  return sum;
}

std::size_t EncodedAsset::detail_bytes() const {
  const auto read = read_manifest(manifest.bytes);
  std::size_t sum = 0;
  for (std::size_t c = 0; read && c < read->chunks.size(); ++c) {
    for (const TileEntry& tile : read->chunks[c].tiles) sum += tile.is(TileKind::kDetail) ? tile.bytes : 0;
  }
  return sum;
}

Result<EncodedAsset> encode_asset(const Asset& asset, const AssetEncoding& encoding) {
  if (auto valid = validate_asset(asset); !valid) {
    const ErrorCode code = valid.error().code;
    return fail(code == ErrorCode::kCorrupt ? ErrorCode::kInvalidArgument : code, valid.error().message);
  }
  return Encoder(asset, encoding).encode();
}

}  // namespace eigencast
