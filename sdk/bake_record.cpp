// SPDX-License-Identifier: MIT
#include "sdk/bake_record.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>

#include "common/asset/format.h"
#include "common/core/bytes.h"

namespace eigencast {
namespace {

constexpr std::uint8_t kRecordVersion = 2;

std::string record_name(const Sha256& key) {
  return "bake-" + key.hex();
}

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
  const auto record = cache.load_record(record_name(key));
  if (!record) return std::nullopt;
  ByteReader in(*record);
  if (in.u8() != kRecordVersion) return std::nullopt;
  BakeResult result;
  const ByteView id = in.bytes(result.encoded.manifest.id.digest.size());
  std::copy(id.begin(), id.end(), result.encoded.manifest.id.digest.begin());
  result.certified = in.u8() != 0;
  result.approximate = in.u8() != 0;
  result.residual = in.f64();
  const ByteView report = in.bytes(in.varint());
  if (!in.finished()) return std::nullopt;
  result.report.assign(report.begin(), report.end());

  auto manifest = cache.load(result.encoded.manifest.id);
  if (!manifest) return std::nullopt;
  result.encoded.manifest.bytes = std::move(*manifest);
  auto reader = AssetReader::from_manifest(result.encoded.manifest.id, result.encoded.manifest.bytes);
  if (!reader) return std::nullopt;
  for (std::size_t i = 0; i < reader->chunks().size(); ++i) {
    const Sha256 chunk_id = reader->chunks()[i].id;
    auto chunk = cache.load(chunk_id);
    if (!chunk || !reader->add_chunk(i, *chunk)) return std::nullopt;
    result.encoded.chunks.push_back({chunk_id, std::move(*chunk)});
  }
  result.asset = std::move(*reader).take();
  if (!result.asset.complete()) return std::nullopt;
  result.from_cache = true;
  return result;
}

Result<void> store_bake(const AssetCache& cache, const Sha256& key, const BakeResult& result) {
  for (const AssetObject& chunk : result.encoded.chunks) {
    if (auto stored = cache.store(chunk.id, chunk.bytes); !stored) return stored;
  }
  const AssetObject& manifest = result.encoded.manifest;
  if (auto stored = cache.store(manifest.id, manifest.bytes); !stored) return stored;
  // The record last: whoever finds it finds what it names.
  return cache.store_record(record_name(key), record_from(result));
}

}  // namespace eigencast
