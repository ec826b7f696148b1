// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/format/columns.h"
#include "common/asset/format/encode.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"

namespace eigencast {

struct ChunkEntry;
struct Manifest;
struct Predictors;
struct StructureTile;

/// Puts an asset together as its objects arrive. Safe on hostile input: each object is hashed before use, each length
/// checked against the manifest, which is checked against the limits. Not thread-safe.
class AssetReader {
 public:
  struct ChunkRef {
    Sha256 id;
    std::uint64_t bytes = 0;
    std::uint64_t needed_bytes = 0;  ///< Leading bytes that this reader's bands need: all that add_chunk must be given.
    std::uint32_t first_row = 0, end_row = 0;
  };
  static constexpr std::size_t kAllBands = ~std::size_t{0};

  /// Reads the manifest, for a receiver of the first `bands` bands: columns beyond them stay zero.
  /// Errors: kCorrupt (hash or content), kIncompatibleVersion, kTooLarge, kUnsupported, kInvalidArgument (bands == 0).
  static Result<AssetReader> from_manifest(const Sha256& id, ByteView manifest, std::size_t bands = kAllBands);

  const std::vector<ChunkRef>& chunks() const { return chunks_; }
  /// The rows that each chunk ends with.
  std::vector<std::uint32_t> chunk_ends() const;
  /// Columns that the asset's stream learnt, to be fetched beside the chunks: where the manifest lists them and this
  /// reader takes all bands.
  struct SectionRef {
    Sha256 id;
    std::uint64_t bytes = 0;
  };
  std::optional<SectionRef> columns() const;
  /// Takes them, before the first chunk. Without them the asset is what its chunks hold. After an error nothing has
  /// changed. Errors: kCorrupt, kTooLarge, kUnsupported, kInvalidArgument (order; there are none).
  Result<void> add_columns(ByteView bytes);
  /// Takes them and, with them, all chunks from a reader that has them. Errors: likewise.
  /// REQUIRES: has_chunks_of(whole).
  Result<void> add_columns_to(const AssetReader& whole, ByteView bytes);
  /// Makes room for columns that somebody else reads. REQUIRES: all chunks are there, check_columns.
  Asset& widen(std::uint32_t columns) {
    eigencast::add_columns(asset_, columns);
    return asset_;
  }
  /// Whether `other` has all chunks of this asset, and nothing else but them.
  bool has_chunks_of(const AssetReader& other) const;
  /// What the whole asset may take at most, in bytes: its arrays while they grow, the copies from which processor and
  /// GPU rebuild poses, poses as they are drawn, the largest chunk unpacked, and those waiting. Without the texture's
  /// pixels.
  std::uint64_t memory_bytes() const;
  /// Takes memory for the whole basis at once, where the caller has granted memory_bytes(): growing takes half as much
  /// again for a while.
  void reserve();
  /// Adds chunk `index`, whole or its first needed_bytes; chunks must come in order. After an error nothing has
  /// changed. Errors: kCorrupt, kInvalidArgument (order).
  Result<void> add_chunk(std::size_t index, ByteView bytes);
  /// What is there so far. Its arrays grow, and move, with the chunks.
  const Asset& asset() const { return asset_; }
  Asset take() && { return std::move(asset_); }

 private:
  AssetReader() = default;
  Result<void> check_columns_are(ByteView bytes) const;
  Result<void> verify(std::size_t index, ByteView bytes) const;
  Result<void> decode(std::size_t index, ByteView bytes);
  void resize_basis(std::size_t rows);
  Result<void> decode_bands(const ChunkEntry& entry, ByteView bytes, const Predictors& predictors);
  Result<void> decode_extras(const ChunkEntry& entry, ByteView bytes, std::span<const std::uint32_t> map);
  Result<std::shared_ptr<const AssetTexture>> decode_texture(const ChunkEntry& entry, ByteView bytes,
                                                             const StructureTile& structure) const;

  Asset asset_;
  std::vector<ChunkRef> chunks_;
  std::size_t next_ = 0;
  std::size_t bands_ = 0;
  std::vector<bool> seen_source_;  // vertices of the source that some row has
  std::shared_ptr<const Manifest> manifest_;
  std::function<Result<void>(std::size_t chunk, std::span<const std::uint32_t> map, Asset& asset)> read_columns_;
};

/// All at once. Errors: as AssetReader.
Result<Asset> decode_asset(const EncodedAsset& encoded);

}  // namespace eigencast
