// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/format/encode.h"
#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// Columns that a stream learns: what its asset's basis misses. They come behind it, as one band more, in a section of
/// a manifest that has the same chunks (docs/asset-format.md).
struct ColumnValues {
  std::vector<float> values;  ///< n x k, row-major, in the asset's order.
  std::vector<float> scales;  ///< k: the unit of each; is_column_scale, not 0.
};

/// Why an asset cannot have k columns more. Errors: kUnsupported (eight bands, detail), kTooLarge.
Result<void> check_columns(const Asset& asset, std::size_t k);

/// Makes room for k columns more, of zeros and scale 0 until they are written, as one band behind the others.
/// REQUIRES: check_columns.
void add_columns(Asset& asset, std::uint32_t k);

/// The manifest that lists the columns, which is another asset's id, and they themselves.
struct EncodedColumns {
  AssetObject manifest, section;

  /// All of the asset with them.
  ///   encoded  of the asset
  EncodedAsset with(const EncodedAsset& encoded) const { return {manifest, encoded.chunks, {section}}; }
};

/// Rounds and codes columns for an asset. Errors: check_columns; kInvalidArgument (shapes, scales, a manifest that has
/// columns already).
///   encoded  of the asset
Result<EncodedColumns> encode_columns(const Asset& asset, const EncodedAsset& encoded, const ColumnValues& columns);

/// The columns' section, taken apart. Safe on hostile input.
class ColumnsSection {
 public:
  static constexpr std::uint32_t kMaxColumns = 64;

  /// Keeps a copy of the bytes. Errors: kCorrupt, kTooLarge.
  ///   chunk_ends  rows after each chunk
  static Result<ColumnsSection> parse(ByteView bytes, std::span<const std::uint32_t> chunk_ends);

  std::uint32_t count() const { return static_cast<std::uint32_t>(scales_.size()); }
  /// The asset with room for the columns, of zeros. Errors: check_columns.
  Result<void> widen(Asset& asset) const;
  /// Reads a chunk's rows into an asset that was widened, whose map has these rows and whose integers have room for
  /// them. Errors: kCorrupt.
  ///   map  of all rows up to the chunk's end
  Result<void> read_chunk(std::size_t chunk, std::span<const std::uint32_t> map, Asset& asset) const;

 private:
  std::vector<float> scales_;
  std::vector<std::uint32_t> chunk_ends_;
  std::vector<std::size_t> tile_ends_;
  Bytes tiles_;
};

/// An asset that is there already, with columns: no chunk is read again. Errors: kCorrupt, kUnsupported, kTooLarge.
/// REQUIRES: it is complete.
Result<Asset> with_columns(const Asset& asset, ByteView section, std::span<const std::uint32_t> chunk_ends);

}  // namespace eigencast
