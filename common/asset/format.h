// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"

namespace eigencast {

struct ChunkEntry;
struct Manifest;
struct Predictors;
struct StructureTile;

/// One content-addressed object: its bytes and their hash.
struct AssetObject {
  Sha256 id;
  Bytes bytes;
};

/// An asset as bytes (docs/asset-format.md): a manifest, whose hash is the asset's id and which lists the hashes of the
/// chunks, and the chunks in level-of-detail order; chunk i holds one range of vertices, tiled by band.
struct EncodedAsset {
  AssetObject manifest;
  std::vector<AssetObject> chunks;
  std::size_t total_bytes() const;
  std::size_t detail_bytes() const;  ///< Of them what Asset::detail takes.
};

/// How the basis is stored. The receivers' basis is the dequantised one, so a sender must project on
/// decode(encode(asset)).
struct AssetEncoding {
  std::uint32_t exact_columns =
      4;  ///< Leading columns kept as float32, so that the rest pose stays exact (default: 4).
  std::uint32_t first_chunk_rows =
      1024;              ///< Vertices in the first chunk at least; each chunk doubles what is there (default: 1024).
  bool compress = true;  ///< zstd where it makes a tile smaller (default: true).
  bool code = true;      ///< Basis tiles coded where that is smaller (default: true).
  /// How large the coefficients get, r: the norms over x, y, z of each, at most. With them the inexact columns get the
  /// steps by which rounding moves a vertex by `error` (root mean square, model units) when they are as large as that;
  /// empty: the finest steps of 16 bits.
  std::vector<double> amplitudes{};
  double error = 0;
};

/// Errors: kInvalidArgument (see validate_asset; the asset must be complete), kTooLarge.
Result<EncodedAsset> encode_asset(const Asset& asset, const AssetEncoding& encoding = {});

/// Puts an asset together as its objects arrive. Safe on hostile input: each object is hashed before use, each length
/// checked against the manifest, which is checked against the limits.
///
/// Not thread-safe.
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
  /// Adds chunk `index`, whole or its first needed_bytes (as an HTTP range gives them); chunks must come in order.
  /// After it asset().rows_ready has grown; after an error nothing has changed. Errors: kCorrupt, kInvalidArgument
  /// (order).
  Result<void> add_chunk(std::size_t index, ByteView bytes);
  /// What is there so far. Its arrays grow with the chunks, so memory is only ever taken for verified bytes; they move
  /// then.
  const Asset& asset() const { return asset_; }
  Asset take() && { return std::move(asset_); }

 private:
  AssetReader() = default;
  Result<void> verify(std::size_t index, ByteView bytes) const;
  Result<void> decode(std::size_t index, ByteView bytes);
  Result<void> decode_bands(const ChunkEntry& entry, ByteView bytes, const Predictors& predictors);
  Result<void> decode_looks(const ChunkEntry& entry, ByteView bytes, std::span<const std::uint32_t> map);
  Result<std::shared_ptr<const AssetTexture>> decode_texture(const ChunkEntry& entry, ByteView bytes,
                                                             const StructureTile& structure) const;

  Asset asset_;
  std::vector<ChunkRef> chunks_;
  std::size_t next_ = 0;
  std::size_t bands_ = 0;
  std::vector<bool> seen_source_;  // vertices of the source that some row has
  std::shared_ptr<const Manifest> manifest_;
};

/// All at once. Errors: as AssetReader.
Result<Asset> decode_asset(const EncodedAsset& encoded);

}  // namespace eigencast
