// SPDX-License-Identifier: MIT
#include "sdk/memory_fetcher.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace eigencast {

void MemoryFetcher::want(control::Remember memory, const control::StreamInfo& info) {
  const auto codec = codec_from_name(info.format.codec);
  if (!codec) return;
  const CoefficientLayout layout{*codec, info.format.rows, info.format.channels, info.format.band_ends};
  const auto& before = wanted_.segments;
  const bool goes_on =
      poses_ && poses_->layout() == layout && asset_ == info.asset && added_ <= memory.segments.size() &&
      std::equal(before.begin(), before.begin() + static_cast<std::ptrdiff_t>(added_), memory.segments.begin());
  if (!goes_on) {
    poses_.emplace(layout);
    added_ = 0;
  }
  asset_ = info.asset;
  wanted_ = std::move(memory);
  complete_ = false;
  std::vector<AssetFetcher::Object> objects;
  for (std::size_t i = added_; i < wanted_.segments.size(); ++i) {
    const auto id = Sha256::from_hex(wanted_.segments[i]);
    if (!id) return give_up(fail(ErrorCode::kCorrupt, "\"" + wanted_.segments[i] + "\" is not an object's id"));
    objects.push_back({*id, PoseMemory::kMaxBytes});
  }
  fetcher_.ask(std::move(objects));
}

bool MemoryFetcher::add_segments() {
  if (complete_) return false;
  for (; added_ < wanted_.segments.size(); ++added_) {
    const auto bytes = fetcher_.take();
    if (!bytes) return false;
    if (const auto added = add(*bytes); !added) {
      give_up(added.error());
      return false;
    }
  }
  return complete_ = true;
}

Result<void> MemoryFetcher::add(ByteView bytes) {
  const auto asset = Sha256::from_hex(asset_);
  const auto segment = decode_segment(poses_->layout(), asset.value_or(Sha256{}).digest, bytes);
  if (!segment) return segment.error();
  auto grown = poses_->with(*segment);
  if (!grown) return grown.error();
  memory_ = {};
  auto memory =
      budget_.take(grown->pose_count() * grown->layout().size() * sizeof(std::int32_t), "its memory of poses");
  if (!memory) return memory.error();
  memory_ = std::move(*memory);
  poses_ = *std::move(grown);
  return {};
}

/// The stream goes on without it: the broker sends keys that need no memory.
void MemoryFetcher::give_up(const Error& why) {
  complete_ = true;
  log(log_, LogLevel::kWarning, "the stream's memory is not used: " + why.message);
  fetcher_.ask({});
}

}  // namespace eigencast
