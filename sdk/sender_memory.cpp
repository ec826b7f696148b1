// SPDX-License-Identifier: MIT
#include "sdk/sender_memory.h"

#include <algorithm>
#include <utility>

#include "common/core/hash/sha256.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

constexpr TimeUs kRetryUs = 10'000'000, kLongestRetryUs = 600'000'000;

}  // namespace

SenderMemory::SenderMemory(CoefficientLayout layout, std::optional<MemoryKeeper::Options> keeper)
    : layout_(std::move(layout)) {
  if (keeper) keeper_.emplace(*std::move(keeper));
}

bool SenderMemory::add(const MemoryKeeper::Sent& sent, TimeUs now_us) {
  const bool grown = keeper_->add(sent);
  return grown || (state_.refused && now_us >= retry_at_us_);
}

Result<void> SenderMemory::want(std::vector<CodedSegment> segments) {
  if (layout_.is_float()) return fail(ErrorCode::kInvalidArgument, "a float codec has no memory");
  if (segments.size() > limits::kMaxMemorySegments)
    return fail(ErrorCode::kTooLarge,
                "a memory has at most " + std::to_string(limits::kMaxMemorySegments) + " segments: put poses together");
  PoseMemory poses(layout_);
  std::vector<AssetObject> objects;
  for (CodedSegment& coded : segments) {
    if (!coded.segment || coded.segment->values.size() != coded.segment->poses * layout_.size())
      return fail(ErrorCode::kInvalidArgument, "a segment of another layout than the stream's");
    auto grown = poses.with(std::move(coded.segment));
    if (!grown) return grown.error();
    poses = *std::move(grown);
    objects.push_back({sha256(coded.bytes), std::move(coded.bytes)});
  }
  if (state_.pending) return fail(ErrorCode::kRefused, "the broker has not answered the last memory yet");
  wanted_ = std::move(objects);
  poses_ = std::make_shared<const PoseMemory>(std::move(poses));
  state_.pending = true;
  state_.refused.reset();
  return {};
}

/// How many of the segments the broker holds, where those are the first of them; else 0.
std::size_t SenderMemory::kept_segments() const {
  const bool extends = held_.size() <= wanted_.size() &&
                       std::equal(held_.begin(), held_.end(), wanted_.begin(),
                                  [](const Sha256& held, const AssetObject& object) { return held == object.id; });
  return extends ? held_.size() : 0;
}

std::vector<AssetObject> SenderMemory::missing() const {
  return {wanted_.begin() + static_cast<std::ptrdiff_t>(kept_segments()), wanted_.end()};
}

control::Remember SenderMemory::message(const std::string& stream) {
  control::Remember m{stream, ++asked_generation_, static_cast<std::uint32_t>(kept_segments()), {}};
  for (const AssetObject& segment : missing()) m.segments.push_back(segment.id.hex());
  return m;
}

bool SenderMemory::asked() {
  if (kept_segments() == held_.size()) return false;
  held_.clear();
  state_.generation = 0;
  return true;
}

std::shared_ptr<const PoseMemory> SenderMemory::hold() {
  state_.pending = false;
  state_.generation = wanted_.empty() ? 0 : asked_generation_;
  retry_us_ = 0;
  held_.clear();
  for (const AssetObject& segment : wanted_) held_.push_back(segment.id);
  return wanted_.empty() ? nullptr : poses_;
}

void SenderMemory::refuse(const Error& why, TimeUs now_us) {
  state_.pending = false;
  state_.refused = why;
  retry_us_ = std::clamp(2 * retry_us_, kRetryUs, kLongestRetryUs);
  // A broker that keeps none is asked again when the connection is new.
  retry_at_us_ = why.code == ErrorCode::kUnsupported ? INT64_MAX : now_us + retry_us_;
}

void SenderMemory::forget() {
  held_.clear();
  state_.generation = 0;
  state_.pending = !wanted_.empty();
  state_.refused.reset();
}

std::uint64_t SenderMemory::saved_bytes() const {
  return keeper_ ? static_cast<std::uint64_t>(std::max(0.0, keeper_->saved_bits()) / 8) : 0;
}

std::uint64_t SenderMemory::bytes() const {
  return keeper_ ? static_cast<std::uint64_t>(keeper_->remembered_bits() / 8) : 0;
}

}  // namespace eigencast
