// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"

namespace eigencast {

struct AssetObject {
  Sha256 id;  ///< Hashes the bytes.
  Bytes bytes;
};

/// An asset as bytes (docs/asset-format.md): a manifest, whose hash is the asset's id and which lists the hashes of the
/// chunks, and the chunks in level-of-detail order; chunk i holds one range of vertices, tiled by band.
struct EncodedAsset {
  AssetObject manifest;
  std::vector<AssetObject> chunks;
  std::vector<AssetObject> sections{};  ///< Those of the manifest that readers take: columns.
  std::size_t total_bytes() const;
  std::size_t detail_bytes() const;  ///< Those that Asset::detail takes.
};

/// How the basis is stored. Receivers have the dequantised one: a sender must project on decode(encode(asset)).
struct AssetEncoding {
  std::uint32_t exact_columns = 4;        ///< Leading columns kept as float32, so that the rest pose stays exact.
  std::uint32_t first_chunk_rows = 1024;  ///< At least; each chunk doubles what is there.
  /// How large the coefficients get, r: the norms over x, y, z of each, at most. With them the inexact columns get the
  /// steps by which rounding moves a vertex by `error` (root mean square, model units) when they are as large as that;
  /// empty: the finest steps of 16 bits.
  std::vector<double> amplitudes{};
  double error = 0;
};

/// Errors: kInvalidArgument (see validate_asset; the asset must be complete), kTooLarge.
Result<EncodedAsset> encode_asset(const Asset& asset, const AssetEncoding& encoding = {});

}  // namespace eigencast
