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

/// The tiles of a chunk beside those of the basis, decompressed (docs/asset-format.md).
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

/// Bounds of a structure tile's size, decompressed.
std::uint64_t min_structure_bytes(std::uint64_t rows, std::uint64_t new_faces);
std::uint64_t max_structure_bytes(std::uint64_t rows, std::uint64_t new_faces, std::uint64_t old_faces);

/// Encodes `tile`, given what earlier chunks hold: map and source_vertex of the rows below first_row, and their faces
/// with the corners of level first_row. REQUIRES: consistent shapes.
Bytes encode_structure(const ChunkRange& range, const StructureTile& tile, std::span<const std::uint32_t> earlier_map,
                       std::span<const std::uint32_t> earlier_source, std::span<const Corners> earlier_faces);

/// The other way round. Safe on hostile input: every index of the result is in range, death ascends, masses are
/// positive, predictors come before what they predict. Errors: kCorrupt. REQUIRES: sizes were checked against
/// the manifest.
Result<StructureTile> decode_structure(ByteView raw, const ChunkRange& range, std::uint32_t new_faces,
                                       std::span<const std::uint32_t> earlier_source,
                                       std::span<const Corners> earlier_faces);

/// Bounds of a splat tile's size, decompressed.
std::uint64_t min_splat_bytes(std::uint64_t rows);
std::uint64_t max_splat_bytes(std::uint64_t rows);

/// The splats of rows [first_row, end_row) of an asset that has them.
///   diagonal  of the rest box: radii are in units of it
Bytes encode_splats(const Asset::Splats& splats, std::uint32_t first_row, std::uint32_t end_row,
                    std::uint32_t base_count, double diagonal);

/// Adds the rows from splats.size() to end_row. Safe on hostile input: frames come before what they turn, normals are
/// of unit length. After an error nothing has changed. Errors: kCorrupt.
Result<void> decode_splats(ByteView raw, std::uint32_t end_row, std::uint32_t base_count, double diagonal,
                           Asset::Splats& splats);

/// The size of a decompressed tile of detail.
///   first_row  of the chunk: the first chunk's tile states what is true of all
std::uint64_t detail_bytes(std::uint64_t rows, std::uint32_t first_row, std::uint32_t rank, std::uint32_t axes);

/// Offsets of an asset whose basis is replaced by another, so that the rest pose stays where it is.
///   basis      n x r, row-major: the one that readers have
Asset::Detail detail_on_basis(const Asset& asset, std::span<const float> basis);

/// The detail of rows [first_row, first_row + map.size()) of an asset that has it.
///   map  of those rows
Bytes encode_detail(const Asset::Detail& detail, std::uint32_t first_row, std::span<const std::uint32_t> map);

/// Adds as many rows as `map` has. Safe on hostile input; after an error nothing has changed. Errors: kCorrupt.
/// REQUIRES: detail.size() rows are there.
Result<void> decode_detail(ByteView raw, std::uint32_t rank, std::span<const std::uint32_t> map, Asset::Detail& detail);

/// The size of a decompressed tile of colours.
std::uint64_t colour_bytes(std::uint64_t rows);

/// The colours of rows [first_row, first_row + map.size()).
///   map      of those rows
///   colours  of all rows up to the last of them, sRGB
Bytes encode_colours(std::span<const std::array<std::uint8_t, 3>> colours, std::uint32_t first_row,
                     std::span<const std::uint32_t> map);

/// The other way round, from the colours of the rows before. Any bytes are colours. REQUIRES: three for each row;
/// map[k] <= earlier.size() + k.
std::vector<std::array<std::uint8_t, 3>> decode_colours(ByteView raw,
                                                        std::span<const std::array<std::uint8_t, 3>> earlier,
                                                        std::span<const std::uint32_t> map);

/// The texture of an asset without its image. REQUIRES: valid.
Bytes encode_uvs(const AssetTexture& texture, const Asset& asset);

/// The other way round, without the image. Safe on hostile input. Errors: kCorrupt.
///   base_count, map, faces   of the finished asset
Result<AssetTexture> decode_uvs(ByteView raw, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                const std::vector<Corners>& faces);

}  // namespace eigencast
