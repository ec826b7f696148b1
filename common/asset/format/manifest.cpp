// SPDX-License-Identifier: MIT
#include "common/asset/format/manifest.h"

#include <algorithm>
#include <array>
#include <utility>

#include "common/asset/asset_limits.h"
#include "common/asset/tiles/tiles.h"
#include "common/core/bands.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kMinChunkEntryBytes = 4 + 4 + 32 + 1;
constexpr std::size_t kTileEntryBytes = 4 + 4 + 4 + 32;
constexpr std::size_t kSectionEntryBytes = 2 + 1 + 8 + 32;

Sha256 get_digest(ByteReader& in) {
  Sha256 id;
  const ByteView view = in.bytes(id.digest.size());
  std::copy(view.begin(), view.end(), id.digest.begin());
  return id;
}

Error corrupt_manifest(std::string what) {
  return fail(ErrorCode::kCorrupt, "asset manifest: " + std::move(what));
}
Error too_large_in_manifest(std::string what, std::uint64_t value, std::uint64_t limit) {
  return fail(ErrorCode::kTooLarge, "asset manifest: " + std::move(what) + " is " + std::to_string(value) +
                                        ", over the limit of " + std::to_string(limit));
}

/// One function for each part of the grammar, in its order.
class Parser {
 public:
  explicit Parser(ByteView bytes) : in_(bytes) {}

  Result<Manifest> parse() {
    for (auto part : {&Parser::header, &Parser::counts, &Parser::bands, &Parser::facts, &Parser::texts,
                      &Parser::numbers, &Parser::chunks, &Parser::sections}) {
      const auto result = (this->*part)();
      if (in_.failed()) return corrupt_manifest("ends too early");
      if (!result) return result.error();
    }
    if (in_.remaining() != 0) return corrupt_manifest(std::to_string(in_.remaining()) + " bytes too many at its end");
    return std::move(manifest_);
  }

 private:
  Result<void> header() {
    const ByteView magic = in_.bytes(kManifestMagic.size());
    if (!std::equal(magic.begin(), magic.end(), kManifestMagic.begin(), kManifestMagic.end()))
      return corrupt_manifest("not one: its magic bytes are missing");
    const std::uint32_t version = in_.u32();
    if (version == 0) return corrupt_manifest("version 0 does not exist");
    if (version != kVersion) {
      return fail(ErrorCode::kIncompatibleVersion, "asset manifest: format version " + std::to_string(version) +
                                                       ", this build reads version 1; bake the asset again or update");
    }
    return {};
  }

  Result<void> counts() {
    AssetFacts& a = manifest_.facts;
    a.vertex_count = in_.u32();
    a.rank = in_.u32();
    a.base_count = in_.u32();
    a.face_total = in_.u32();
    manifest_.exact_columns = in_.u32();
    if (auto counts = check_counts(a); !counts) return in_context("asset manifest", counts.error());
    if (manifest_.exact_columns > a.rank) return corrupt_manifest("more exact columns than columns");
    return {};
  }

  Result<void> bands() {
    const std::size_t count = in_.u8();
    if (count > asset_limits::kMaxBands) return corrupt_manifest(std::to_string(count) + " bands; 1 to 8 are allowed");
    for (std::size_t b = 0; b < count; ++b) manifest_.facts.band_ends.push_back(in_.u32());
    return {};
  }

  Result<void> facts() {
    AssetFacts& a = manifest_.facts;
    const std::uint8_t up = in_.u8();
    const std::uint8_t handed = in_.u8();
    if (up > 3 || handed > 1) return corrupt_manifest("unknown up axis or handedness");
    a.up_axis = static_cast<Asset::UpAxis>(up);
    a.handedness = static_cast<Asset::Handedness>(handed);
    a.metres_per_unit = in_.f64();
    a.area = in_.f64();
    for (auto* triple : {&a.box_low, &a.box_high, &a.origin}) {
      for (double& x : *triple) x = in_.f64();
    }
    return {};
  }

  Result<void> texts() {
    const ByteView kind = in_.bytes(in_.u8());
    if (kind.size() > asset_limits::kMaxBasisKindBytes) return corrupt_manifest("basis kind is too long");
    manifest_.facts.basis_kind.assign(kind.begin(), kind.end());
    const ByteView name = in_.bytes(in_.u16());
    if (name.size() > asset_limits::kMaxNameBytes) return corrupt_manifest("name is too long");
    manifest_.facts.name.assign(name.begin(), name.end());
    return {};
  }

  Result<void> numbers() {
    AssetFacts& a = manifest_.facts;
    const std::size_t scales = a.rank - manifest_.exact_columns;
    if (in_.remaining() < a.rank * 3 * sizeof(double) + scales * sizeof(float))
      return corrupt_manifest("ends too early");
    a.rest.resize(std::size_t{a.rank} * 3);
    for (double& c : a.rest) c = in_.f64();
    manifest_.column_scales.resize(scales);
    for (float& s : manifest_.column_scales) {
      s = in_.f32();
      // The largest integer is 32767: scale * 32767 must still be a float.
      if (!asset_limits::is_column_scale(s)) return corrupt_manifest("a column scale is out of range");
    }
    if (auto facts = check_facts(a); !facts) return in_context("asset manifest", facts.error());
    return {};
  }

  Result<void> chunks() {
    const AssetFacts& a = manifest_.facts;
    const std::size_t count = in_.u32();
    if (count == 0 || count > asset_limits::kMaxChunks)
      return corrupt_manifest(std::to_string(count) + " chunks; 1 to 4096 are allowed");
    if (in_.remaining() < count * kMinChunkEntryBytes) return corrupt_manifest("ends too early");
    std::uint32_t row = 0;
    std::uint32_t face = 0;
    for (std::size_t i = 0; i < count; ++i) {
      ChunkEntry& chunk = manifest_.chunks.emplace_back();
      if (auto result = one_chunk(i, row, face, chunk); !result) return result;
      row = chunk.end_row;
      face = chunk.end_face;
    }
    if (row != a.vertex_count || face != a.face_total)
      return corrupt_manifest("the chunks do not cover all vertices and faces");
    return {};
  }

  Result<void> one_chunk(std::size_t i, std::uint32_t first_row, std::uint32_t first_face, ChunkEntry& chunk) {
    const AssetFacts& a = manifest_.facts;
    const std::string where = "chunk " + std::to_string(i);
    chunk.end_row = in_.u32();
    chunk.end_face = in_.u32();
    chunk.id = get_digest(in_);
    const std::size_t tiles = in_.u8();
    if (chunk.end_row <= first_row || chunk.end_row > a.vertex_count || (i == 0 && chunk.end_row < a.base_count)) {
      return corrupt_manifest(where + ": its range of vertices is out of order");
    }
    if (chunk.end_face < first_face || chunk.end_face > a.face_total)
      return corrupt_manifest(where + ": its range of faces is out of order");
    if (tiles < 1 + a.band_ends.size() || tiles > asset_limits::kMaxTilesPerChunk) {
      return corrupt_manifest(where + ": " + std::to_string(tiles) + " tiles for " +
                              std::to_string(a.band_ends.size()) + " bands");
    }
    if (in_.remaining() < tiles * kTileEntryBytes) return corrupt_manifest("ends too early");
    for (std::size_t t = 0; t < tiles; ++t) {
      TileEntry tile;
      const std::uint64_t rows = chunk.end_row - first_row;
      const std::uint64_t faces = chunk.end_face - first_face;
      const std::string which = where + " tile " + std::to_string(t);
      if (auto read = one_tile(which, t, first_row, rows, faces, first_face, tile); !read) return read;
      chunk.tiles.push_back(tile);
    }
    const std::uint64_t stored = chunk.stored_bytes();
    if (stored > asset_limits::kMaxObjectBytes)
      return too_large_in_manifest(where, stored, asset_limits::kMaxObjectBytes);
    std::uint64_t raw = 0;
    for (const TileEntry& tile : chunk.tiles) raw += tile.raw_bytes;
    const std::uint64_t allowed = asset_limits::kFreeGrowth + stored * asset_limits::kMaxExpansion;
    if (raw > allowed) return too_large_in_manifest(where + ", decompressed,", raw, allowed);
    return {};
  }

  Result<void> one_tile(const std::string& where, std::size_t t, std::uint32_t first_row, std::uint64_t rows,
                        std::uint64_t faces, std::uint64_t old_faces, TileEntry& tile) {
    tile.kind = in_.u8();
    tile.index = in_.u8();
    const std::uint8_t required = in_.u8();
    const std::uint8_t compression = in_.u8();
    tile.stored_bytes = in_.u32();
    tile.raw_bytes = in_.u32();
    tile.hash = get_digest(in_);
    if (required > 1) return corrupt_manifest(where + ": reserved flag bits are set");
    tile.required = required == 1;
    const bool known = t <= manifest_.facts.band_ends.size();
    const bool coded = compression == static_cast<std::uint8_t>(Compression::kCoded);
    if (compression > 1 && !(coded && known && t > 0)) {
      if (!known && !tile.required) {
        tile.raw_bytes = 0;  // never decompressed
        return {};
      }
      return fail(ErrorCode::kUnsupported,
                  "asset manifest: " + where + ": unknown compression " + std::to_string(compression));
    }
    tile.compression = static_cast<Compression>(compression);
    if (tile.raw_bytes > asset_limits::kMaxTileBytes)
      return too_large_in_manifest(where, tile.raw_bytes, asset_limits::kMaxTileBytes);
    if (tile.compression == Compression::kStored && tile.raw_bytes != tile.stored_bytes) {
      return corrupt_manifest(where + ": stored, yet its two sizes differ");
    }
    return known ? known_tile(where, t, rows, faces, old_faces, tile) : extra_tile(where, first_row, rows, tile);
  }

  Result<void> known_tile(const std::string& where, std::size_t t, std::uint64_t rows, std::uint64_t faces,
                          std::uint64_t old_faces, const TileEntry& tile) {
    const std::size_t index = t == 0 ? 0 : t - 1;
    if (!tile.is(t == 0 ? TileKind::kStructure : TileKind::kBasis) || tile.index != index || !tile.required) {
      return corrupt_manifest(where + ": not the structure tile first and then the bands in order, all required");
    }
    const std::uint64_t least =
        t > 0 ? basis_tile_bytes(manifest_, index, static_cast<std::uint32_t>(rows)) : min_structure_bytes(rows, faces);
    const std::uint64_t most = t > 0 ? least : max_structure_bytes(rows, faces, old_faces);
    if (tile.raw_bytes < least || tile.raw_bytes > most)
      return corrupt_manifest(where + ": " + std::to_string(tile.raw_bytes) + " bytes do not fit its rows and faces");
    return {};
  }

  Result<void> extra_tile(const std::string& where, std::uint32_t first_row, std::uint64_t rows,
                          const TileEntry& tile) {
    if (tile.kind == 0 || tile.is(TileKind::kStructure) || tile.is(TileKind::kBasis))
      return corrupt_manifest(where + ": a second structure or basis tile");
    const auto detail = [&](std::uint32_t axes) { return detail_bytes(rows, first_row, manifest_.facts.rank, axes); };
    const bool is_splats = tile.is(TileKind::kSplats), is_colours = tile.is(TileKind::kColours) && tile.index == 0,
               is_detail = tile.is(TileKind::kDetail) && tile.index == 0;
    const std::uint64_t bytes = tile.raw_bytes;
    if ((is_splats && (bytes < min_splat_bytes(rows) || bytes > max_splat_bytes(rows))) ||
        (is_colours && bytes != colour_bytes(rows)) || (is_detail && bytes != detail(1) && bytes != detail(3))) {
      return corrupt_manifest(where + ": " + std::to_string(bytes) + " bytes do not fit its rows");
    }
    if (is_splats || is_colours || is_detail) return {};
    if (tile.is(TileKind::kImage) && tile.raw_bytes > AssetTexture::kMaxImageBytes)
      return too_large_in_manifest(where + ", an image,", tile.raw_bytes, AssetTexture::kMaxImageBytes);
    if (tile.required) {
      return fail(ErrorCode::kUnsupported, "asset manifest: " + where + " is required and of kind " +
                                               std::to_string(tile.kind) +
                                               ", which this build does not know; update Eigencast");
    }
    return {};
  }

  Result<void> sections() {
    const std::size_t count = in_.u16();
    if (count > asset_limits::kMaxSections)
      return too_large_in_manifest("section count", count, asset_limits::kMaxSections);
    if (in_.remaining() < count * kSectionEntryBytes) return corrupt_manifest("ends too early");
    for (std::size_t i = 0; i < count; ++i) {
      SectionEntry section;
      section.kind = in_.u16();
      const std::uint8_t required = in_.u8();
      section.bytes = in_.u64();
      section.id = get_digest(in_);
      if (required > 1) return corrupt_manifest("section " + std::to_string(i) + ": reserved flag bits are set");
      section.required = required == 1;
      if (section.bytes > asset_limits::kMaxObjectBytes)
        return too_large_in_manifest("a section", section.bytes, asset_limits::kMaxObjectBytes);
      if (section.required) {
        return fail(ErrorCode::kUnsupported, "asset manifest: section " + std::to_string(i) +
                                                 " is required and of kind " + std::to_string(section.kind) +
                                                 ", which this build does not know; update Eigencast");
      }
      manifest_.sections.push_back(section);
    }
    return {};
  }

  ByteReader in_;
  Manifest manifest_;
};

void write_chunk_entry(ByteWriter& out, const ChunkEntry& chunk) {
  out.u32(chunk.end_row);
  out.u32(chunk.end_face);
  out.bytes(chunk.id.digest);
  out.u8(static_cast<std::uint8_t>(chunk.tiles.size()));
  for (const TileEntry& tile : chunk.tiles) {
    out.u8(tile.kind);
    out.u8(tile.index);
    out.u8(tile.required ? 1 : 0);
    out.u8(static_cast<std::uint8_t>(tile.compression));
    out.u32(tile.stored_bytes);
    out.u32(tile.raw_bytes);
    out.bytes(tile.hash.digest);
  }
}

}  // namespace

std::uint64_t ChunkEntry::stored_bytes() const {
  std::uint64_t sum = 0;
  for (const TileEntry& tile : tiles) sum += tile.stored_bytes;
  return sum;
}

Bytes write_manifest(const Manifest& manifest) {
  Bytes bytes;
  ByteWriter out(bytes);
  const AssetFacts& a = manifest.facts;
  out.bytes(kManifestMagic);
  for (const std::uint32_t v : {kVersion, a.vertex_count, a.rank, a.base_count, a.face_total, manifest.exact_columns})
    out.u32(v);
  out.u8(static_cast<std::uint8_t>(a.band_ends.size()));
  for (const std::uint32_t end : a.band_ends) out.u32(end);
  out.u8(static_cast<std::uint8_t>(a.up_axis));
  out.u8(static_cast<std::uint8_t>(a.handedness));
  out.f64(a.metres_per_unit);
  out.f64(a.area);
  for (const auto* triple : {&a.box_low, &a.box_high, &a.origin}) {
    for (const double x : *triple) out.f64(x);
  }
  out.u8(static_cast<std::uint8_t>(a.basis_kind.size()));
  out.text(a.basis_kind);
  out.u16(static_cast<std::uint16_t>(a.name.size()));
  out.text(a.name);
  for (const double c : a.rest) out.f64(c);
  for (const float s : manifest.column_scales) out.f32(s);
  out.u32(static_cast<std::uint32_t>(manifest.chunks.size()));
  for (const ChunkEntry& chunk : manifest.chunks) write_chunk_entry(out, chunk);
  out.u16(static_cast<std::uint16_t>(manifest.sections.size()));
  for (const SectionEntry& section : manifest.sections) {
    out.u16(section.kind);
    out.u8(section.required ? 1 : 0);
    out.u64(section.bytes);
    out.bytes(section.id.digest);
  }
  return bytes;
}

Result<Manifest> read_manifest(ByteView bytes) {
  if (bytes.size() > asset_limits::kMaxManifestBytes)
    return too_large_in_manifest("its size", bytes.size(), asset_limits::kMaxManifestBytes);
  return Parser(bytes).parse();
}

std::vector<Sha256> objects_of_manifest(ByteView bytes) {
  std::vector<Sha256> ids;
  ByteReader in(bytes);
  in.bytes(kManifestMagic.size());
  const std::uint32_t version = in.u32();
  in.u32();  // Vertices.
  const std::size_t rank = in.u32();
  in.u64();  // Those of the base; faces.
  const std::size_t exact = in.u32();
  if (version != kVersion || rank > asset_limits::kMaxRank || exact > rank) return {};
  in.bytes(in.u8() * sizeof(std::uint32_t));  // Bands.
  in.bytes(2 + 11 * sizeof(double));          // Axes, metres, area, box, origin.
  in.bytes(in.u8());                          // Kind.
  in.bytes(in.u16());                         // Name.
  in.bytes(3 * sizeof(double) * rank + sizeof(float) * (rank - exact));
  const std::uint32_t chunks = in.u32();
  if (chunks > asset_limits::kMaxChunks) return {};
  for (std::uint32_t left = chunks; left > 0 && !in.failed(); --left) {
    in.u64();  // Rows, faces.
    ids.push_back(get_digest(in));
    in.bytes(in.u8() * kTileEntryBytes);
  }
  const std::uint32_t sections = in.u16();
  if (sections > asset_limits::kMaxSections) return {};
  for (std::uint32_t left = sections; left > 0 && !in.failed(); --left) {
    in.bytes(kSectionEntryBytes - sizeof(Sha256::digest));
    ids.push_back(get_digest(in));
  }
  return in.finished() ? ids : std::vector<Sha256>();
}

std::uint64_t basis_tile_bytes(const Manifest& manifest, std::size_t band, std::uint32_t rows) {
  const auto [begin, end] = band_range(manifest.facts.band_ends, band);
  const std::uint32_t first_integer = std::clamp(manifest.exact_columns, begin, end);
  return std::uint64_t{rows} * (4 * (first_integer - begin) + 2 * (end - first_integer));
}

}  // namespace eigencast
