// SPDX-License-Identifier: MIT
#include "common/asset/format/columns.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "common/asset/format/manifest.h"
#include "common/core/hash/sha256.h"
#include "web/core/core.h"
#include "web/core/error.h"

using namespace eigencast;

struct core_columns {
  Manifest manifest;
  SectionEntry entry;
  core_chunk section{};
  Asset read{};  ///< The columns alone.
  core_learnt learnt{};

  Result<void> take(ByteView bytes, std::span<const std::uint32_t> map);
};

Result<void> core_columns::take(ByteView bytes, std::span<const std::uint32_t> map) {
  if (bytes.size() != entry.bytes || sha256(bytes) != entry.id)
    return fail(ErrorCode::kCorrupt, "columns of an asset: their bytes do not have the hash " + entry.id.hex());
  std::vector<std::uint32_t> ends;
  for (const ChunkEntry& chunk : manifest.chunks) ends.push_back(chunk.end_row);
  const auto parsed = ColumnsSection::parse(bytes, ends);
  if (!parsed) return parsed.error();
  static_cast<AssetFacts&>(read) = manifest.facts;
  read.rows_ready = read.vertex_count;
  if (const auto widened = parsed->widen(read); !widened) return widened;
  for (std::size_t chunk = 0; chunk < ends.size(); ++chunk) {
    if (const auto rows = parsed->read_chunk(chunk, map, read); !rows) return rows;
  }
  learnt = {read.column_scales.data(), read.integers.data(), parsed->count()};
  return {};
}

core_columns* columns_open(const uint8_t* manifest, uint32_t size) {
  auto read = read_manifest({manifest, size});
  if (!read) return web::no(read.error());
  const SectionEntry* entry = find_columns(*read);
  if (entry == nullptr) return web::no(fail(ErrorCode::kNotFound, "the asset has no learnt columns"));
  for (const TileEntry& tile : read->chunks.front().tiles) {
    if (tile.is(TileKind::kDetail)) return web::no(fail(ErrorCode::kUnsupported, "columns of an asset: it has detail"));
  }
  const SectionEntry section = *entry;
  auto* made = new core_columns{std::move(*read), section};
  std::copy(section.id.digest.begin(), section.id.digest.end(), made->section.id);
  made->section.bytes = static_cast<std::uint32_t>(section.bytes);
  return made;
}

void columns_free(core_columns* columns) {
  delete columns;
}

const core_chunk* columns_section(core_columns* columns) {
  return &columns->section;
}

const core_learnt* columns_read(core_columns* columns, const uint8_t* section, uint32_t size, const uint32_t* map) {
  const auto taken = columns->take({section, size}, {map, columns->manifest.facts.vertex_count});
  return taken ? &columns->learnt : web::no(taken.error());
}
