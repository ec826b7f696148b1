// SPDX-License-Identifier: MIT
#include "broker/storage/segments.h"

#include <exception>
#include <memory>
#include <string>

namespace eigencast::broker {
namespace {

Result<void> load(const AssetStore& assets, const CoefficientLayout& layout, const AssetDigest& asset,
                  std::vector<Generation::Segment>& segments) {
  std::uint64_t poses = 0;
  for (Generation::Segment& segment : segments) {
    if (!segment.poses) {
      const Sha256 id = *Sha256::from_hex(segment.id);
      const auto object = assets.read(id);
      if (!object) return object.error();
      if (object->size > PoseMemory::kMaxBytes)
        return fail(ErrorCode::kTooLarge, "segment " + segment.id + " is over 8 MiB");
      auto bytes = assets.bytes_of(id);
      if (!bytes) return bytes.error();
      segment.coded = std::make_shared<const Bytes>(*std::move(bytes));
      auto decoded = decode_segment(layout, asset, *segment.coded);
      if (!decoded) return decoded.error();
      segment.poses = *std::move(decoded);
    }
    if (auto fits = PoseMemory::check_size(layout, poses += segment.poses->poses); !fits) return fits;
  }
  return {};
}

}  // namespace

Result<void> load_segments(const AssetStore& assets, const CoefficientLayout& layout, const AssetDigest& asset,
                           std::vector<Generation::Segment>& segments) try {
  return load(assets, layout, asset, segments);
} catch (const std::exception& exception) {
  return fail(ErrorCode::kInternal, exception.what());
}

}  // namespace eigencast::broker
