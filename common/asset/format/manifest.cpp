// SPDX-License-Identifier: MIT
#include "common/asset/format/manifest.h"

#include <algorithm>
#include <array>
#include <utility>

#include "common/asset/asset_limits.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kVersion = 1;
constexpr std::size_t kMinChunkEntryBytes = 4 + 4 + 32 + 1;
constexpr std::size_t kTileEntryBytes = 3 + 4 + 32;
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
    for (std::string* kind : {&manifest_.facts.basis_kind, &manifest_.facts.operator_kind}) {
      const ByteView text = in_.bytes(in_.u8());
      if (text.size() > asset_limits::kMaxKindBytes) return corrupt_manifest("the kind of its basis is too long");
      kind->assign(text.begin(), text.end());
    }
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
    const std::size_t levels = in_.u8();
    if (levels > asset_limits::kMaxLevelErrors) return corrupt_manifest("its list of levels is too long");
    for (std::size_t i = 0; i < levels; ++i) {
      GeometricError& error = a.level_errors.emplace_back();
      error.rows = in_.u32();
      error.rms = in_.f32();
      error.largest = in_.f32();
    }
    if (in_.failed()) return corrupt_manifest("ends too early");
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
      auto tile = one_tile(where + " tile " + std::to_string(t), t);
      if (!tile) return tile.error();
      chunk.tiles.push_back(*tile);
    }
    const std::uint64_t bytes = chunk.bytes();
    if (bytes > asset_limits::kMaxObjectBytes)
      return too_large_in_manifest(where, bytes, asset_limits::kMaxObjectBytes);
    const std::uint64_t taken = memory_of(chunk, chunk.end_row - first_row, chunk.end_face - first_face);
    const std::uint64_t allowed = asset_limits::kFreeGrowth + bytes * asset_limits::kMaxExpansion;
    if (taken > allowed) return too_large_in_manifest(where + ", in memory,", taken, allowed);
    return {};
  }

  /// What decoding the chunk adds to the asset's arrays, about.
  std::uint64_t memory_of(const ChunkEntry& chunk, std::uint64_t rows, std::uint64_t faces) const {
    constexpr std::uint64_t kRowBytes = 12, kFaceBytes = 16;
    const std::uint64_t exact = manifest_.exact_columns, rank = manifest_.facts.rank;
    std::uint64_t row_bytes = kRowBytes + 4 * exact + 2 * (rank - exact);
    for (const TileEntry& tile : chunk.tiles) row_bytes += tile.is(TileKind::kDetail) ? 4 * rank : 0;
    return rows * row_bytes + faces * kFaceBytes;
  }

  Result<TileEntry> one_tile(const std::string& where, std::size_t t) {
    TileEntry tile;
    tile.kind = in_.u8();
    tile.index = in_.u8();
    const std::uint8_t required = in_.u8();
    tile.bytes = in_.u32();
    tile.hash = get_digest(in_);
    if (required > 1) return corrupt_manifest(where + ": reserved flag bits are set");
    tile.required = required == 1;
    const bool is_basis = t > 0 && t <= manifest_.facts.band_ends.size();
    if (t == 0 || is_basis) {
      const std::size_t index = is_basis ? t - 1 : 0;
      if (!tile.is(is_basis ? TileKind::kBasis : TileKind::kStructure) || tile.index != index || !tile.required)
        return corrupt_manifest(where + ": not the structure tile first and then the bands in order, all required");
      return tile;
    }
    if (tile.kind == 0 || tile.is(TileKind::kStructure) || tile.is(TileKind::kBasis))
      return corrupt_manifest(where + ": a second structure or basis tile");
    const bool known = tile.is(TileKind::kSplats) || tile.is(TileKind::kColours) || tile.is(TileKind::kDetail) ||
                       tile.is(TileKind::kUvs) || tile.is(TileKind::kImage) || tile.is(TileKind::kNormals);
    if (tile.is(TileKind::kImage) && tile.bytes > AssetTexture::kMaxImageBytes)
      return too_large_in_manifest(where + ", an image,", tile.bytes, AssetTexture::kMaxImageBytes);
    if (tile.required && !(known && tile.index == 0)) {
      return fail(ErrorCode::kUnsupported, "asset manifest: " + where + " is required and of kind " +
                                               std::to_string(tile.kind) +
                                               ", which this build does not know; update Eigencast");
    }
    return tile;
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
    out.u32(tile.bytes);
    out.bytes(tile.hash.digest);
  }
}

}  // namespace

std::uint64_t ChunkEntry::bytes() const {
  std::uint64_t sum = 0;
  for (const TileEntry& tile : tiles) sum += tile.bytes;
  return sum;
}

const SectionEntry* find_columns(const Manifest& manifest) {
  for (const SectionEntry& section : manifest.sections) {
    if (section.kind == kColumnsSection) return &section;
  }
  return nullptr;
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
  for (const std::string& kind : {a.basis_kind, a.operator_kind}) {
    out.u8(static_cast<std::uint8_t>(kind.size()));
    out.text(kind);
  }
  out.u16(static_cast<std::uint16_t>(a.name.size()));
  out.text(a.name);
  for (const double c : a.rest) out.f64(c);
  for (const float s : manifest.column_scales) out.f32(s);
  out.u8(static_cast<std::uint8_t>(a.level_errors.size()));
  for (const GeometricError& error : a.level_errors) {
    out.u32(error.rows);
    out.f32(error.rms);
    out.f32(error.largest);
  }
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
  in.bytes(in.u8());                          // Kind of basis,
  in.bytes(in.u8());                          // of operator.
  in.bytes(in.u16());                         // Name.
  in.bytes(3 * sizeof(double) * rank + sizeof(float) * (rank - exact));
  in.bytes(in.u8() * 3 * sizeof(float));  // Levels.
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

}  // namespace eigencast
