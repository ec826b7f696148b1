// SPDX-License-Identifier: MIT
#include "web/core/asset.h"

#include <algorithm>
#include <string>

#include "common/core/bands.h"
#include "web/core/error.h"

using namespace eigencast;

namespace {
std::uint64_t numbers = 0;
}

core_asset* asset_open(const uint8_t* id, const uint8_t* manifest, uint32_t size, uint32_t bands, double max_bytes) {
  Sha256 hash;
  std::copy_n(id, hash.digest.size(), hash.digest.begin());
  auto reader = AssetReader::from_manifest(hash, ByteView(manifest, size), bands == 0 ? AssetReader::kAllBands : bands);
  if (!reader) return web::no(reader.error());
  const auto needed = static_cast<double>(reader->memory_bytes());
  if (!(needed <= max_bytes)) {
    return web::no(fail(ErrorCode::kTooLarge, "the surface may take " + std::to_string(reader->memory_bytes()) +
                                                  " bytes of memory, more than the limit given"));
  }
  if (bands == 0) reader->reserve();  // Of fewer the first chunk may do, and a manifest may lie.
  return new core_asset{std::move(*reader), ++numbers};
}

void asset_free(core_asset* asset) {
  delete asset;
}

uint32_t asset_chunk_count(const core_asset* asset) {
  return static_cast<std::uint32_t>(asset->reader.chunks().size());
}

const core_chunk* asset_chunk(core_asset* asset, uint32_t index) {
  const auto& chunks = asset->reader.chunks();
  if (index >= chunks.size()) return web::no(fail(ErrorCode::kInvalidArgument, "the asset has fewer chunks"));
  const AssetReader::ChunkRef& ref = chunks[index];
  core_chunk& chunk = asset->chunk;
  std::copy(ref.id.digest.begin(), ref.id.digest.end(), chunk.id);
  chunk.bytes = static_cast<std::uint32_t>(ref.bytes);
  chunk.needed_bytes = static_cast<std::uint32_t>(ref.needed_bytes);
  chunk.first_row = ref.first_row;
  chunk.end_row = ref.end_row;
  return &chunk;
}

int32_t asset_add(core_asset* asset, uint32_t index, const uint8_t* bytes, uint32_t size) {
  return web::status_of(asset->reader.add_chunk(index, ByteView(bytes, size)));
}

const core_basis* asset_widen(core_asset* held, uint32_t columns) {
  Asset& asset = held->reader.widen(columns);
  held->number = ++numbers;
  held->basis = {asset.integers.data(), asset.column_scales.data(),
                 static_cast<std::uint32_t>(asset.column_scales.size())};
  return &held->basis;
}

const core_facts* asset_facts(core_asset* held) {
  const Asset& asset = held->reader.asset();
  core_facts& facts = held->facts = {};
  facts.metres_per_unit = asset.metres_per_unit;
  std::copy(asset.box_low.begin(), asset.box_low.end(), facts.box_low);
  std::copy(asset.box_high.begin(), asset.box_high.end(), facts.box_high);
  std::copy(asset.origin.begin(), asset.origin.end(), facts.origin);
  facts.rest = asset.rest.data();
  facts.vertex_count = asset.vertex_count;
  facts.rank = asset.rank;
  facts.base_count = asset.base_count;
  facts.face_total = asset.face_total;
  facts.rows_ready = asset.rows_ready;
  facts.faces_ready = asset.faces_ready;
  facts.up_axis = static_cast<std::uint32_t>(asset.up_axis);
  facts.is_left_handed = asset.handedness == AssetFacts::Handedness::kLeft ? 1 : 0;
  facts.bands = static_cast<std::uint32_t>(asset.band_ends.size());
  std::copy(asset.band_ends.begin(), asset.band_ends.end(), facts.band_ends);
  facts.has_detail = asset.detail.size() > 0 ? 1 : 0;
  facts.has_splats = asset.splats.size() > 0 ? 1 : 0;
  facts.colours = asset.colours.empty() ? nullptr : asset.colours.front().data();
  if (asset.texture) {
    facts.image = asset.texture->image.data();
    facts.image_bytes = static_cast<std::uint32_t>(asset.texture->image.size());
  }
  facts.name = asset.name.c_str();
  facts.area = asset.area;
  facts.has_columns = held->reader.columns() ? 1 : 0;
  facts.map = asset.map.data();
  facts.normals = asset.normals.empty() ? nullptr : asset.normals.data();
  return &facts;
}

uint32_t asset_source(const core_asset* held, uint32_t vertex, uint32_t is_textured) {
  const Asset& asset = held->reader.asset();
  if (is_textured != 0 && asset.texture) {
    const auto& first = asset.texture->first_wedge;
    vertex = static_cast<std::uint32_t>(std::upper_bound(first.begin(), first.end(), vertex) - first.begin()) - 1;
  }
  return vertex < asset.rows_ready ? asset.source_vertex[vertex] : ~std::uint32_t{0};
}

int32_t asset_fill(const core_asset* held, double* coefficients, uint32_t count, uint32_t channels, uint32_t bands) {
  const Asset& asset = held->reader.asset();
  if (channels < 3 || count != std::uint64_t{asset.rank} * channels)
    return web::failed(fail(ErrorCode::kInvalidArgument, "the pose has another size than the surface"));
  for (std::size_t band = 0; band < asset.band_ends.size(); ++band) {
    if (BandMask(static_cast<std::uint8_t>(bands)).has(band)) continue;
    const auto [first, end] = band_range(asset.band_ends, band);
    for (std::size_t row = first; row < end; ++row) std::copy_n(&asset.rest[3 * row], 3, &coefficients[row * channels]);
  }
  return 0;
}
