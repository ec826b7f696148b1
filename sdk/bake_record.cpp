// SPDX-License-Identifier: MIT
#include "sdk/bake_parts.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <span>
#include <utility>

#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/core/bytes.h"
#include "common/surface/vector.h"
#include "sdk/asset_folder.h"

namespace eigencast {
namespace {

constexpr std::uint8_t kRecordVersion = 3;
constexpr std::uint8_t kPlaceVersion = 1;
/// Over the diagonal: points that were moved rigidly and rounded to floats.
constexpr double kRigidTolerance = 1e-5;

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

Vec3 mean_of(std::span<const Vec3> points) {
  const Vec3 sum =
      std::accumulate(points.begin(), points.end(), Vec3{}, [](const Vec3& a, const Vec3& b) { return a + b; });
  return 1.0 / static_cast<double>(std::max<std::size_t>(points.size(), 1)) * sum;
}

/// The point farthest from the mean, and the one farthest from the line through both.
std::array<std::size_t, 2> corners_of(std::span<const Vec3> points) {
  const Vec3 mean = mean_of(points);
  const auto farthest = [&](auto distance) {
    std::size_t most = 0;
    for (std::size_t i = 1; i < points.size(); ++i) {
      if (distance(points[i] - mean) > distance(points[most] - mean)) most = i;
    }
    return most;
  };
  const std::size_t first = farthest([](const Vec3& d) { return length(d); });
  return {first, farthest([&](const Vec3& d) { return length(cross(points[first] - mean, d)); })};
}

/// The mean of points, and axes by two of them; no axes where these lie on a line.
struct Place {
  Place(std::span<const Vec3> points, const std::array<std::size_t, 2>& corners) : mean(mean_of(points)) {
    const Vec3 x = points[corners[0]] - mean, z = cross(x, points[corners[1]] - mean);
    axes = {unit(x), unit(z), {}};
    axes[2] = cross(axes[1], axes[0]);
  }
  Vec3 mean;
  std::array<Vec3, 3> axes;
};

struct RigidMotion {
  Place from, to;
  Vec3 turned(const Vec3& v) const {
    Vec3 sum{};
    for (std::size_t k = 0; k < 3; ++k) sum = sum + dot(from.axes[k], v) * to.axes[k];
    return sum;
  }
  Vec3 moved(const Vec3& p) const { return turned(p - from.mean) + to.mean; }
};

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

Result<void> store_place(const AssetCache& cache, const Sha256& shape, const Sha256& key, const Surface& surface) {
  Bytes positions;
  ByteWriter out(positions);
  for (const Vec3& p : surface.positions)
    for (const double x : p) out.f64(x);
  const Sha256 id = sha256(positions);
  if (auto stored = cache.store(id, positions); !stored) return stored;
  Bytes record;
  ByteWriter place(record);
  place.u8(kPlaceVersion);
  place.bytes(key.digest);
  place.bytes(id.digest);
  return cache.store_record(shape, record);
}

std::optional<BakeResult> load_moved(const AssetCache& cache, const Sha256& shape, const Surface& surface) {
  const auto record = cache.load_record(shape);
  if (!record) return std::nullopt;
  ByteReader in(*record);
  if (in.u8() != kPlaceVersion) return std::nullopt;
  Sha256 key, id;
  for (Sha256* hash : {&key, &id}) {
    const ByteView digest = in.bytes(hash->digest.size());
    std::copy(digest.begin(), digest.end(), hash->digest.begin());
  }
  const auto bytes = in.finished() ? cache.load(id) : std::nullopt;
  if (!bytes || bytes->size() != 24 * surface.vertex_count()) return std::nullopt;
  std::vector<Vec3> before(surface.vertex_count());
  ByteReader numbers(*bytes);
  for (Vec3& p : before)
    for (double& x : p) x = numbers.f64();
  const auto corners = corners_of(before);
  const RigidMotion motion{Place(before, corners), Place(surface.positions, corners)};
  const Box box = bounding_box(surface.positions);
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (!(length(motion.moved(before[i]) - surface.positions[i]) <= kRigidTolerance * box.diagonal()))
      return std::nullopt;
  }
  auto found = load_bake(cache, key, {});
  if (!found) return std::nullopt;
  auto manifest = read_manifest(found->encoded.manifest.bytes);
  if (!manifest) return std::nullopt;
  AssetFacts& facts = manifest->facts;
  for (std::size_t k = 0; k < facts.rank; ++k) {
    double* row = &facts.rest[3 * k];
    const Vec3 turned = motion.turned({row[0], row[1], row[2]});
    std::copy(turned.begin(), turned.end(), row);
  }
  facts.origin = motion.moved(facts.origin);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    facts.box_low[axis] = box.low[axis] - facts.origin[axis];
    facts.box_high[axis] = box.high[axis] - facts.origin[axis];
  }
  static_cast<AssetFacts&>(found->asset) = facts;
  found->encoded.manifest.bytes = write_manifest(*manifest);
  found->encoded.manifest.id = sha256(found->encoded.manifest.bytes);
  return found;
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
