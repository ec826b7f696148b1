// SPDX-License-Identifier: MIT
//
// A hostile asset, whole: how many bands are read, the manifest and the chunks after it. An enemy computes hashes, too,
// so those of the manifest are replaced by the ones that its chunks have. What is taken, in part or whole, is sound and
// can be drawn at every level; what is whole is the same when it is written and read again. The bytes that remain are
// columns for it, to which its poses are carried over.
#include <algorithm>
#include <cstdlib>

#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "common/reconstruction/level_triangles.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/transfer.h"

using namespace eigencast;

namespace {

constexpr std::size_t kMaxEntries = 20'000;  // of a basis, and bytes of chunks: fuzzers are to be quick
constexpr std::size_t kMaxBytes = 1 << 16;

void require(bool condition) {
  if (!condition) std::abort();
}

/// Chunks of the sizes that the manifest states, filled with what there is and then with zeros, and a manifest that has
/// their hashes.
EncodedAsset hashed(Manifest& manifest, ByteReader& in) {
  EncodedAsset encoded;
  for (ChunkEntry& chunk : manifest.chunks) {
    AssetObject object;
    for (TileEntry& tile : chunk.tiles) {
      const ByteView there = in.bytes(std::min<std::size_t>(tile.bytes, in.remaining()));
      Bytes stored(there.begin(), there.end());
      stored.resize(tile.bytes);
      tile.hash = sha256(stored);
      object.bytes.insert(object.bytes.end(), stored.begin(), stored.end());
    }
    object.id = chunk.id = sha256(object.bytes);
    encoded.chunks.push_back(std::move(object));
  }
  encoded.manifest.bytes = write_manifest(manifest);
  encoded.manifest.id = sha256(encoded.manifest.bytes);
  return encoded;
}

/// Everything that a viewer does with as much of an asset as has arrived.
void draw(const Asset& asset) {
  const std::uint32_t rows = asset.rows_ready;
  require(asset.floats.size() + asset.integers.size() == std::size_t{rows} * asset.rank && asset.map.size() == rows &&
          asset.mass.size() == rows && asset.faces.size() == asset.faces_ready &&
          asset.death.size() == asset.faces_ready);
  if (rows < asset.base_count) return;
  Reconstructor reconstructor;
  reconstructor.update(asset);
  LevelTriangles levels;
  std::vector<std::uint32_t> moved;
  levels.update(asset, moved);
  std::vector<float> positions(std::size_t{3} * rows), normals(positions.size()), radii(rows);
  for (const std::uint32_t N : {asset.base_count, rows, (asset.base_count + rows) / 2}) {
    const auto floats = std::size_t{3} * N;
    const PoseToRebuild pose{asset.rest, 3, std::span(positions).first(floats),
                             reconstructor.has_detail() ? std::span(normals).first(floats) : std::span<float>()};
    reconstructor.rebuild(std::span(&pose, 1), asset.rank, N);
    const auto triangles = triangles_at_level(asset, N);
    vertex_normals(pose.positions, triangles, std::span(normals).first(floats));
    levels.set_level(N, moved);
    require(moved == triangles);
    splat_normals(asset, pose.positions, std::span(normals).first(floats));
    splat_radii(asset, N, std::span(radii).first(N));
  }
}

bool same_entries(const Asset& a, const Asset& b) {
  for (std::size_t i = 0; i < a.vertex_count; ++i) {
    for (std::size_t k = 0; k < a.rank; ++k) {
      if (a.entry(i, k) != b.entry(i, k)) return false;
    }
  }
  return true;
}

/// What is written, every column as 32-bit floats, is what is read.
void write_and_read(const Asset& asset) {
  const auto encoded = encode_asset(asset, {.exact_columns = asset.rank});
  require(encoded.has_value());
  const auto again = decode_asset(*encoded);
  require(again.has_value() && same_entries(*again, asset) && again->map == asset.map && again->faces == asset.faces &&
          again->death == asset.death && again->mass == asset.mass && again->source_vertex == asset.source_vertex &&
          again->rest == asset.rest && again->colours == asset.colours && again->normals == asset.normals &&
          again->splats.frame == asset.splats.frame);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ByteReader in(ByteView(data, size));
  const std::size_t bands = 1 + in.u8() % 8;
  const std::size_t length = in.u16();
  auto manifest = read_manifest(in.bytes(std::min(length, in.remaining())));
  if (!manifest || std::size_t{manifest->facts.vertex_count} * manifest->facts.rank > kMaxEntries) return 0;
  std::uint64_t bytes = 0;
  for (const ChunkEntry& chunk : manifest->chunks) bytes += chunk.bytes();
  if (bytes > kMaxBytes) return 0;

  const EncodedAsset encoded = hashed(*manifest, in);
  auto reader = AssetReader::from_manifest(encoded.manifest.id, encoded.manifest.bytes, bands);
  if (!reader) return 0;
  for (std::size_t i = 0; i < encoded.chunks.size(); ++i) {
    const auto wanted = static_cast<std::size_t>(reader->chunks()[i].needed_bytes);
    const ByteView whole = encoded.chunks[i].bytes;
    const bool added = reader->add_chunk(i, bands == 8 ? whole : whole.first(wanted)).has_value();
    draw(reader->asset());
    if (!added) return 0;
  }
  require(validate_asset(reader->asset()).has_value());
  const auto wider = with_columns(reader->asset(), in.bytes(in.remaining()), reader->chunk_ends());
  if (wider) {
    require(validate_asset(*wider).has_value() && wider->rank > reader->asset().rank);
    draw(*wider);
    const auto transfer = Transfer::between(reader->asset(), *wider);
    if (transfer) require(transfer->apply(reader->asset().rest, 3).size() == std::size_t{3} * wider->rank);
  }
  if (bands == 8) write_and_read(reader->asset());
  return 0;
}
