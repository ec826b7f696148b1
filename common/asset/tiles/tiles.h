// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/tiles/predictor.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

/// The tiles of a chunk beside those of the basis (docs/asset-format.md): numbers, coded.
namespace eigencast {

/// What a chunk adds to the connectivity, and what it changes in the faces that came before.
struct StructureTile {
  std::vector<std::uint32_t> map;
  std::vector<std::uint32_t> source_vertex;
  std::vector<float> mass;
  std::vector<Corners> faces;        ///< New ones, corners below end_row.
  std::vector<std::uint32_t> death;  ///< Has one for each new face.
  std::vector<Corners> old_faces;    ///< All earlier ones, their corners moved on from first_row to end_row.
  Predictors predictors;             ///< Predict the new rows.
};

struct ChunkRange {
  std::uint32_t first_row = 0, end_row = 0;
  std::uint32_t base_count = 0;    ///< q
  std::uint32_t vertex_count = 0;  ///< n
};

/// What earlier chunks hold: rows below first_row, and their faces with the corners of level first_row.
struct EarlierStructure {
  std::span<const std::uint32_t> source_vertex;
  std::span<const float> mass;
  std::span<const Corners> faces;
};

/// REQUIRES: consistent shapes.
Bytes encode_structure(const ChunkRange& range, const StructureTile& tile, const EarlierStructure& earlier);

/// The other way round. Safe on hostile input: every index of the result is in range, death ascends, masses are
/// positive, predictors come before what they predict. Errors: kCorrupt. REQUIRES: counts were checked against the
/// limits.
Result<StructureTile> decode_structure(ByteView coded, const ChunkRange& range, std::uint32_t new_faces,
                                       const EarlierStructure& earlier);

/// The splats of rows [first_row, end_row) of an asset that has them.
///   diagonal  of the rest box: radii are in units of it
Bytes encode_splats(const Asset::Splats& splats, std::uint32_t first_row, std::uint32_t end_row,
                    std::uint32_t base_count, double diagonal);

/// Adds the rows from splats.size() to end_row. Safe on hostile input: frames come before what they turn, normals are
/// of unit length. After an error nothing has changed. Errors: kCorrupt.
Result<void> decode_splats(ByteView coded, std::uint32_t end_row, std::uint32_t base_count, double diagonal,
                           Asset::Splats& splats);

/// Offsets of an asset whose basis is replaced by another, so that the rest pose stays where it is.
///   basis      n x r, row-major: the one that readers have
Asset::Detail detail_on_basis(const Asset& asset, std::span<const float> basis);

/// The detail of rows [first_row, first_row + map.size()) of an asset that has it.
///   map  of those rows
Bytes encode_detail(const Asset::Detail& detail, std::uint32_t first_row, std::span<const std::uint32_t> map);

/// Adds as many rows as `map` has. Safe on hostile input; after an error nothing has changed. Errors: kCorrupt.
/// REQUIRES: detail.size() rows are there.
Result<void> decode_detail(ByteView coded, std::uint32_t rank, std::span<const std::uint32_t> map,
                           Asset::Detail& detail);

/// The colours of rows [first_row, first_row + map.size()).
///   map      of those rows
///   colours  of all rows up to the last of them, sRGB
Bytes encode_colours(std::span<const std::array<std::uint8_t, 3>> colours, std::uint32_t first_row,
                     std::span<const std::uint32_t> map);

/// The other way round, from the colours of the rows before. Errors: kCorrupt. REQUIRES: map[k] <= earlier.size() + k.
Result<std::vector<std::array<std::uint8_t, 3>>> decode_colours(ByteView coded,
                                                                std::span<const std::array<std::uint8_t, 3>> earlier,
                                                                std::span<const std::uint32_t> map);

/// What is known of the normals of rows [first_row, first_row + map.size()).
///   map      of those rows
///   normals  of all rows up to the last of them
Bytes encode_normals(std::span<const std::uint8_t> normals, std::uint32_t first_row,
                     std::span<const std::uint32_t> map);

/// Adds as many rows as `map` has. Errors: kCorrupt. REQUIRES: normals of all rows before them.
Result<void> decode_normals(ByteView coded, std::span<const std::uint32_t> map, std::vector<std::uint8_t>& normals);

/// The most wedges that a texture may have.
constexpr std::uint64_t max_wedges(std::uint64_t vertices, std::uint64_t faces) {
  return vertices + 3 * faces;
}

/// The texture of an asset without its image. REQUIRES: valid.
Bytes encode_uvs(const AssetTexture& texture, const Asset& asset);

/// The other way round, without the image. Safe on hostile input. Errors: kCorrupt.
///   base_count, map, faces   of the finished asset
Result<AssetTexture> decode_uvs(ByteView coded, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                const std::vector<Corners>& faces);

}  // namespace eigencast
