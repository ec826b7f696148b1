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

constexpr std::uint8_t kRecordVersion = 3;

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
  out.u8(result.trial && result.trial->is_made ? 1 : 0);
  out.varint(result.trial ? result.trial->points.size() : 0);
  for (const TrialPoint& p : result.trial ? result.trial->points : std::vector<TrialPoint>()) {
    out.u32(static_cast<std::uint32_t>(p.rank));
    out.u32(static_cast<std::uint32_t>(p.products));
    for (const double value : {p.coding, p.error, p.kbit_per_s}) out.f64(value);
  }
  return bytes;
}

}  // namespace

std::optional<BakeResult> load_bake(const AssetCache& cache, const Sha256& key, const std::optional<BakeWish>& wish) {
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
  const bool is_made = in.u8() != 0;
  std::vector<TrialPoint> points;
  for (std::uint64_t left = in.varint(); left > 0 && !in.failed(); --left) {
    TrialPoint& p = points.emplace_back();
    p.rank = static_cast<int>(in.u32());
    p.products = static_cast<int>(in.u32());
    for (double* value : {&p.coding, &p.error, &p.kbit_per_s}) *value = in.f64();
  }
  if (!in.finished() || points.empty() == wish.has_value()) return std::nullopt;
  result.report.assign(report.begin(), report.end());

  auto whole = assemble_asset(id, [&](const Sha256& object) -> Result<Bytes> {
    auto bytes = cache.load(object);
    return bytes ? Result<Bytes>(std::move(*bytes)) : fail(ErrorCode::kNotFound, object.hex());
  });
  if (!whole) return std::nullopt;
  result.asset = std::move(whole->asset);
  if (wish) {
    result.trial = choose(std::move(points), *wish, is_made);
    result.trial->chosen = result.trial->points.back();
    result.asset.coding_error = result.trial->chosen.coding * result.asset.diagonal();
  }
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
