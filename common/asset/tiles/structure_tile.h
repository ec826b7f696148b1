// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/tiles/predictor.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// What one chunk adds to the connectivity, and what it changes in the faces that came before.
struct StructureTile {
  std::vector<std::uint32_t> map;
  std::vector<std::uint32_t> source_vertex;
  std::vector<float> mass;
  std::vector<Corners> faces;        ///< New ones, corners below end_row.
  std::vector<std::uint32_t> death;  ///< Of the new ones.
  std::vector<Corners> old_faces;    ///< All earlier ones, their corners moved on from first_row to end_row.
  Predictors predictors;             ///< Of the new rows.
};

/// The rows of a chunk.
struct ChunkRange {
  std::uint32_t first_row = 0, end_row = 0;
  std::uint32_t base_count = 0;    ///< q
  std::uint32_t vertex_count = 0;  ///< n
};

/// Encodes `tile`, given what earlier chunks hold: map and source_vertex of the rows below first_row, and their faces
/// with the corners of level first_row. REQUIRES: consistent shapes.
Bytes encode_structure(const ChunkRange& range, const StructureTile& tile, std::span<const std::uint32_t> earlier_map,
                       std::span<const std::uint32_t> earlier_source, std::span<const Corners> earlier_faces);

/// The other way round. Safe on hostile input: every index of the result is in range, death ascends, masses are
/// positive, predictors come before what they predict. Errors: kCorrupt. REQUIRES: raw was checked against
/// max_structure_bytes, new_faces against the manifest.
Result<StructureTile> decode_structure(ByteView raw, const ChunkRange& range, std::uint32_t new_faces,
                                       std::span<const std::uint32_t> earlier_source,
                                       std::span<const Corners> earlier_faces);

}  // namespace eigencast
