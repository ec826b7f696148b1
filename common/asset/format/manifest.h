// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast {

inline constexpr std::array<std::uint8_t, 8> kManifestMagic = {'E', 'C', 'A', 'S', 'S', 'E', 'T', '\n'};

/// What a tile of a chunk holds. Values are on the wire; docs/asset-format.md lists the reserved ones.
enum class TileKind : std::uint8_t {
  kStructure = 1,
  kBasis = 2,
  kUvs = 16,
  kNormals = 17,
  kColours = 18,
  kSplats = 20,
  kImage = 21,
  kDetail = 22
};

/// Tiles lie back to back in a chunk, in the order of the list.
struct TileEntry {
  std::uint8_t kind = 0;   ///< TileKind, or one that this reader does not know.
  std::uint8_t index = 0;  ///< kBasis: the band. Else 0.
  bool required = true;    ///< A reader that does not know the kind must refuse the asset.
  std::uint32_t bytes = 0;
  Sha256 hash;  ///< Covers them.

  bool is(TileKind known) const { return kind == static_cast<std::uint8_t>(known); }
};

struct ChunkEntry {
  std::uint32_t end_row = 0;   ///< Vertices after this chunk; the chunk before says where it begins.
  std::uint32_t end_face = 0;  ///< Faces after this chunk: those with death < end_row.
  Sha256 id;                   ///< Hashes all the chunk's bytes.
  std::vector<TileEntry> tiles;
  std::uint64_t bytes() const;
};

/// The kind of the section that holds columns (asset/format/columns.h).
inline constexpr std::uint16_t kColumnsSection = 36;

/// An object that belongs to the whole asset, such as a texture.
struct SectionEntry {
  std::uint16_t kind = 0;
  bool required = false;
  std::uint64_t bytes = 0;
  Sha256 id;
};

/// The first object of an asset; its hash is the asset's id.
struct Manifest {
  AssetFacts facts;
  std::uint32_t exact_columns = 0;
  std::vector<float> column_scales;  ///< r - exact_columns: value = scale * integer; is_column_scale.
  std::vector<ChunkEntry> chunks;
  std::vector<SectionEntry> sections;
};

/// Null where it lists none.
const SectionEntry* find_columns(const Manifest& manifest);

Bytes write_manifest(const Manifest& manifest);

/// Safe on hostile input. What it returns is consistent: counts within asset_limits.h, chunks covering all rows and
/// faces in order, the tiles of each chunk being structure, every band in order, then optional ones. Errors: kCorrupt,
/// kIncompatibleVersion, kTooLarge, kUnsupported (a required tile or section of unknown kind).
Result<Manifest> read_manifest(ByteView bytes);

/// The ids of the chunks and sections of a manifest, whether this build knows their kinds or not; none if it is damaged
/// or of another version. Safe on hostile input.
std::vector<Sha256> objects_of_manifest(ByteView bytes);

}  // namespace eigencast
