// SPDX-License-Identifier: MIT
#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "common/asset/asset.h"
#include "common/asset/asset_limits.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "common/asset/tiles/basis_tile.h"
#include "common/asset/tiles/tiles.h"
#include "common/core/bands.h"
#include "common/core/worker_team.h"

namespace eigencast {
namespace {

std::string chunk_name(std::size_t index) {
  return "asset chunk " + std::to_string(index);
}

/// The tile of a kind that may be absent, of set 0; nothing where `bytes` end before it.
std::optional<ByteView> find_tile(const ChunkEntry& chunk, ByteView bytes, TileKind kind) {
  std::size_t at = 0;
  for (const TileEntry& tile : chunk.tiles) {
    if (at + tile.bytes > bytes.size()) break;
    if (tile.is(kind) && tile.index == 0) return bytes.subspan(at, tile.bytes);
    at += tile.bytes;
  }
  return std::nullopt;
}

template <typename T>
void append(std::vector<T>& to, const std::vector<T>& from) {
  to.reserve(to.size() + from.size());
  to.insert(to.end(), from.begin(), from.end());
}

}  // namespace

Result<AssetReader> AssetReader::from_manifest(const Sha256& id, ByteView manifest, std::size_t bands) {
  if (bands == 0) return fail(ErrorCode::kInvalidArgument, "asset: a receiver needs at least one band");
  if (sha256(manifest) != id)
    return fail(ErrorCode::kCorrupt, "asset manifest: its bytes do not have the hash " + id.hex());
  auto parsed = read_manifest(manifest);
  if (!parsed) return parsed.error();
  AssetReader reader;
  reader.manifest_ = std::make_shared<const Manifest>(std::move(*parsed));
  static_cast<AssetFacts&>(reader.asset_) = reader.manifest_->facts;
  reader.asset_.column_scales = reader.manifest_->column_scales;
  reader.bands_ = std::min(bands, reader.asset_.band_ends.size());
  std::uint32_t row = 0;
  for (const ChunkEntry& entry : reader.manifest_->chunks) {
    ChunkRef ref{entry.id, entry.bytes(), 0, row, entry.end_row};
    for (std::size_t t = 0; t <= reader.bands_; ++t) ref.needed_bytes += entry.tiles[t].bytes;
    reader.chunks_.push_back(ref);
    row = entry.end_row;
  }
  return reader;
}

std::vector<std::uint32_t> AssetReader::chunk_ends() const {
  std::vector<std::uint32_t> ends;
  for (const ChunkRef& chunk : chunks_) ends.push_back(chunk.end_row);
  return ends;
}

std::optional<AssetReader::SectionRef> AssetReader::columns() const {
  const SectionEntry* section = find_columns(*manifest_);
  if (section == nullptr || bands_ < manifest_->facts.band_ends.size()) return std::nullopt;
  return SectionRef{section->id, section->bytes};
}

Result<void> AssetReader::check_columns_are(ByteView bytes) const {
  const auto ref = columns();
  if (!ref || next_ > 0 || read_columns_)
    return fail(ErrorCode::kInvalidArgument, "columns of an asset: none are due here, before its first chunk");
  if (bytes.size() != ref->bytes || sha256(bytes) != ref->id)
    return fail(ErrorCode::kCorrupt, "columns of an asset: their bytes do not have the hash " + ref->id.hex());
  return {};
}

Result<void> AssetReader::add_columns_to(const AssetReader& whole, ByteView bytes) {
  if (const auto due = check_columns_are(bytes); !due) return due;
  if (const auto added = store(asset_, with_columns(whole.asset_, bytes, chunk_ends())); !added) return added;
  next_ = chunks_.size();
  return {};
}

bool AssetReader::has_chunks_of(const AssetReader& other) const {
  const Manifest &mine = *manifest_, &others = *other.manifest_;
  return other.next_ == other.chunks_.size() && !other.read_columns_ && other.bands_ == bands_ &&
         static_cast<const AssetFacts&>(other.asset_) == others.facts && mine.facts == others.facts &&
         mine.exact_columns == others.exact_columns && mine.column_scales == others.column_scales &&
         std::equal(mine.chunks.begin(), mine.chunks.end(), others.chunks.begin(), others.chunks.end(),
                    [](const ChunkEntry& a, const ChunkEntry& b) { return a.id == b.id && a.end_row == b.end_row; });
}

Result<void> AssetReader::add_columns(ByteView bytes) {
  if (const auto due = check_columns_are(bytes); !due) return due;
  for (const TileEntry& tile : manifest_->chunks.front().tiles) {
    if (tile.is(TileKind::kDetail)) return fail(ErrorCode::kUnsupported, "columns of an asset: it has detail");
  }
  auto section = ColumnsSection::parse(bytes, chunk_ends());
  if (!section) return section.error();
  if (const auto widened = section->widen(asset_); !widened) return widened;
  // Not a member of its type: what never adds columns, as the page, has no code for them.
  read_columns_ = [section = std::move(*section)](std::size_t chunk, std::span<const std::uint32_t> map, Asset& asset) {
    return section.read_chunk(chunk, map, asset);
  };
  return {};
}

void AssetReader::reserve() {
  asset_.floats.reserve(std::size_t{asset_.vertex_count} * asset_.float_columns());
  asset_.integers.reserve(std::size_t{asset_.vertex_count} * asset_.column_scales.size());
}

std::uint64_t AssetReader::memory_bytes() const {
  // Beside the basis: an asset's arrays, poses and what is drawn of them, in memory and on the GPU.
  constexpr std::uint64_t kVertexBytes = 192, kFaceBytes = 96, kWedgeBytes = 24;
  constexpr std::uint64_t kModelBytes = std::uint64_t{1} << 20;  // of decoders
  // Three of each: the asset's, the processor's and the GPU's.
  constexpr std::uint64_t kFloatBytes = 3 * sizeof(float), kIntegerBytes = 3 * sizeof(std::int16_t);
  std::uint64_t largest_chunk = 0, extras = 0;
  std::uint64_t row_bytes = asset_.float_columns() * kFloatBytes + asset_.column_scales.size() * kIntegerBytes;
  if (columns()) row_bytes += kIntegerBytes * ColumnsSection::kMaxColumns;
  const std::uint64_t detailed_row_bytes = row_bytes + 2 * kIntegerBytes * asset_.rank;
  for (const ChunkEntry& chunk : manifest_->chunks) {
    largest_chunk = std::max(largest_chunk, chunk.bytes());
    for (const TileEntry& tile : chunk.tiles) {
      if (tile.is(TileKind::kDetail)) row_bytes = detailed_row_bytes;
      if (tile.is(TileKind::kUvs)) extras += kWedgeBytes * max_wedges(asset_.vertex_count, asset_.face_total);
      if (tile.is(TileKind::kImage)) extras += tile.bytes;
    }
  }
  return std::uint64_t{asset_.vertex_count} * (row_bytes + kVertexBytes) + asset_.face_total * kFaceBytes + extras +
         4 * largest_chunk + kModelBytes;  // One chunk, two that are ready, one that is on its way.
}

Result<void> AssetReader::add_chunk(std::size_t index, ByteView bytes) {
  if (index != next_ || index >= chunks_.size()) {
    return fail(ErrorCode::kInvalidArgument, chunk_name(index) + ": chunks must come in order, the next is " +
                                                 std::to_string(next_) + " of " + std::to_string(chunks_.size()));
  }
  if (auto result = verify(index, bytes); !result) return in_context(chunk_name(index), result.error());
  if (auto result = decode(index, bytes); !result) return in_context(chunk_name(index), result.error());
  ++next_;
  return {};
}

Result<void> AssetReader::verify(std::size_t index, ByteView bytes) const {
  const ChunkRef& ref = chunks_[index];
  if (bytes.size() != ref.bytes && bytes.size() != ref.needed_bytes) {
    return fail(ErrorCode::kCorrupt,
                "it has " + std::to_string(bytes.size()) + " bytes, the manifest says " + std::to_string(ref.bytes));
  }
  if (bytes.size() == ref.bytes && sha256(bytes) != ref.id) {
    return fail(ErrorCode::kCorrupt, "its bytes do not have the hash " + ref.id.hex());
  }
  // The tiles too: otherwise a manifest could name bytes that only receivers of all bands accept.
  std::size_t at = 0;
  for (const TileEntry& tile : manifest_->chunks[index].tiles) {
    if (at == bytes.size()) break;
    if (sha256(bytes.subspan(at, tile.bytes)) != tile.hash) {
      return fail(ErrorCode::kCorrupt, "the tile at byte " + std::to_string(at) + " does not have its hash");
    }
    at += tile.bytes;
  }
  return {};
}

Result<void> AssetReader::decode(std::size_t index, ByteView bytes) {
  const ChunkEntry& entry = manifest_->chunks[index];
  const ChunkRange range{asset_.rows_ready, entry.end_row, asset_.base_count, asset_.vertex_count};
  auto structure = decode_structure(bytes.first(entry.tiles[0].bytes), range, entry.end_face - asset_.faces_ready,
                                    {asset_.source_vertex, asset_.mass, asset_.faces});
  if (!structure) return structure.error();
  std::vector<bool> seen = seen_source_;
  seen.resize(asset_.vertex_count, false);
  for (const std::uint32_t source : structure->source_vertex) {
    if (seen[source]) return fail(ErrorCode::kCorrupt, "source vertex " + std::to_string(source) + " comes twice");
    seen[source] = true;
  }

  resize_basis(entry.end_row);
  Result<void> decoded = decode_bands(entry, bytes, structure->predictors);
  if (decoded && read_columns_) {
    std::vector<std::uint32_t> map = asset_.map;
    append(map, structure->map);
    decoded = read_columns_(index, map, asset_);
  }
  auto texture = decode_texture(entry, bytes, *structure);
  if (decoded && !texture) decoded = texture.error();
  if (decoded) decoded = decode_extras(entry, bytes, structure->map);
  if (!decoded) {
    resize_basis(range.first_row);
    return decoded;
  }
  asset_.texture = std::move(*texture);
  append(asset_.map, structure->map);
  append(asset_.source_vertex, structure->source_vertex);
  append(asset_.mass, structure->mass);
  append(asset_.death, structure->death);
  asset_.faces = std::move(structure->old_faces);
  append(asset_.faces, structure->faces);
  seen_source_ = std::move(seen);
  asset_.rows_ready = entry.end_row;
  asset_.faces_ready = entry.end_face;
  return {};
}

void AssetReader::resize_basis(std::size_t rows) {
  const std::size_t floats = rows * asset_.float_columns(), integers = rows * asset_.column_scales.size();
  asset_.floats.reserve(floats);
  asset_.floats.resize(floats, 0.0F);
  asset_.integers.reserve(integers);
  asset_.integers.resize(integers, 0);
}

/// Bands share neither bytes nor columns: at the same time, the last one, which is the largest, first.
Result<void> AssetReader::decode_bands(const ChunkEntry& entry, ByteView bytes, const Predictors& predictors) {
  std::vector<std::size_t> begin{entry.tiles[0].bytes};
  for (std::size_t b = 0; b < bands_; ++b) begin.push_back(begin.back() + entry.tiles[1 + b].bytes);
  std::vector<Result<void>> results(bands_);
  worker_team().run(bands_, [&](std::size_t task) {
    const std::size_t b = bands_ - 1 - task;
    const auto [first_column, end_column] = band_range(asset_.band_ends, b);
    const BasisBlock block{asset_.rows_ready,        entry.end_row, first_column,         end_column,
                           manifest_->exact_columns, asset_.rank,   asset_.column_scales, predictors};
    results[b] =
        decode_basis(block, bytes.subspan(begin[b], entry.tiles[1 + b].bytes), {asset_.floats, asset_.integers});
  });
  for (Result<void>& result : results) {
    if (!result) return std::move(result);
  }
  return {};
}

/// What is not required is there for all rows or for none: a chunk without it ends it.
Result<void> AssetReader::decode_extras(const ChunkEntry& entry, ByteView bytes, std::span<const std::uint32_t> map) {
  const auto colour_tile = find_tile(entry, bytes, TileKind::kColours);
  std::vector<std::array<std::uint8_t, 3>> colours;
  if (colour_tile && asset_.colours.size() == asset_.rows_ready) {
    auto decoded = decode_colours(*colour_tile, asset_.colours, map);
    if (!decoded) return decoded.error();
    colours = std::move(*decoded);
  }
  const auto normals_tile = find_tile(entry, bytes, TileKind::kNormals);
  std::vector<std::uint8_t> normals;
  if (normals_tile && asset_.normals.size() == asset_.rows_ready) {
    normals = asset_.normals;
    if (auto decoded = decode_normals(*normals_tile, map, normals); !decoded) return decoded;
  }
  // With fewer bands more is missing than detail brings.
  const auto detail_tile = bands_ < asset_.band_ends.size() ? std::nullopt : find_tile(entry, bytes, TileKind::kDetail);
  const bool has_detail = detail_tile && asset_.detail.size() == asset_.rows_ready;
  const auto splat_tile = find_tile(entry, bytes, TileKind::kSplats);
  const bool has_splats = splat_tile && asset_.is_point_cloud() && asset_.splats.size() == asset_.rows_ready;
  if (has_splats) {
    auto decoded = decode_splats(*splat_tile, entry.end_row, asset_.base_count, asset_.diagonal(), asset_.splats);
    if (!decoded) return decoded;
  }
  if (has_detail) {
    if (auto decoded = decode_detail(*detail_tile, asset_.rank, map, asset_.detail); !decoded) {
      if (has_splats) asset_.splats.resize(asset_.rows_ready);
      return decoded;
    }
  }
  if (!has_splats) asset_.splats = {};
  if (!has_detail) asset_.detail = {};
  colours.empty() ? asset_.colours.clear() : append(asset_.colours, colours);
  asset_.normals = std::move(normals);
  return {};
}

/// Comes with the last chunk: only then all corners are where they belong.
Result<std::shared_ptr<const AssetTexture>> AssetReader::decode_texture(const ChunkEntry& entry, ByteView bytes,
                                                                        const StructureTile& structure) const {
  const auto uv_tile = find_tile(entry, bytes, TileKind::kUvs);
  const auto image_tile = find_tile(entry, bytes, TileKind::kImage);
  if (entry.end_row != asset_.vertex_count || !uv_tile || !image_tile || image_tile->empty())
    return std::shared_ptr<const AssetTexture>();
  std::vector<std::uint32_t> map = asset_.map;
  append(map, structure.map);
  std::vector<Corners> faces = structure.old_faces;
  append(faces, structure.faces);
  auto texture = decode_uvs(*uv_tile, asset_.base_count, map, faces);
  if (!texture) return texture.error();
  texture->image.assign(image_tile->begin(), image_tile->end());
  return std::make_shared<const AssetTexture>(std::move(*texture));
}

Result<Asset> decode_asset(const EncodedAsset& encoded) {
  auto reader = AssetReader::from_manifest(encoded.manifest.id, encoded.manifest.bytes);
  if (!reader) return reader.error();
  if (encoded.chunks.size() != reader->chunks().size()) {
    return fail(ErrorCode::kCorrupt, "asset: " + std::to_string(encoded.chunks.size()) +
                                         " chunks, its manifest lists " + std::to_string(reader->chunks().size()));
  }
  for (const AssetObject& section : encoded.sections) {
    if (auto added = reader->add_columns(section.bytes); !added) return added.error();
  }
  for (std::size_t i = 0; i < encoded.chunks.size(); ++i) {
    if (auto added = reader->add_chunk(i, encoded.chunks[i].bytes); !added) return added.error();
  }
  return std::move(*reader).take();
}

}  // namespace eigencast
