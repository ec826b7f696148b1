// SPDX-License-Identifier: MIT
#include "sdk/bake_parts.h"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "common/asset/format/encode.h"
#include "common/core/bytes.h"
#include "sdk/asset_folder.h"

namespace eigencast {
namespace {

constexpr std::uint8_t kRecordVersion = 2;

Bytes record_from(const BakeResult& result) {
  Bytes bytes;
  bytes.reserve(64 + result.report.size());
  ByteWriter out(bytes);
  out.u8(kRecordVersion);
  out.bytes(result.encoded.manifest.id.digest);
  out.u8(result.certified ? 1 : 0);
  out.u8(result.approximate ? 1 : 0);
  out.f64(result.residual);
  out.varint(result.report.size());
  out.text(result.report);
  return bytes;
}

}  // namespace

std::optional<BakeResult> load_bake(const AssetCache& cache, const Sha256& key) {
  const auto record = cache.load_record(key);
  if (!record) return std::nullopt;
  ByteReader in(*record);
  if (in.u8() != kRecordVersion) return std::nullopt;
  BakeResult result;
  Sha256 id;
  const ByteView digest = in.bytes(id.digest.size());
  std::copy(digest.begin(), digest.end(), id.digest.begin());
  result.certified = in.u8() != 0;
  result.approximate = in.u8() != 0;
  result.residual = in.f64();
  const ByteView report = in.bytes(in.varint());
  if (!in.finished()) return std::nullopt;
  result.report.assign(report.begin(), report.end());

  auto whole = assemble_asset(id, [&](const Sha256& object) -> Result<Bytes> {
    auto bytes = cache.load(object);
    return bytes ? Result<Bytes>(std::move(*bytes)) : fail(ErrorCode::kNotFound, object.hex());
  });
  if (!whole) return std::nullopt;
  result.asset = std::move(whole->asset);
  result.encoded = std::move(whole->encoded);
  result.from_cache = true;
  return result;
}

Result<void> store_bake(const AssetCache& cache, const Sha256& key, const BakeResult& result) {
  for (const AssetObject& chunk : result.encoded.chunks) {
    if (auto stored = cache.store(chunk.id, chunk.bytes); !stored) return stored;
  }
  const AssetObject& manifest = result.encoded.manifest;
  if (auto stored = cache.store(manifest.id, manifest.bytes); !stored) return stored;
  // The record last: what it names is there before it.
  return cache.store_record(key, record_from(result));
}

}  // namespace eigencast
