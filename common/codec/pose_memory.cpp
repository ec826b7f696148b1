// SPDX-License-Identifier: MIT
#include "common/codec/pose_memory.h"

#include <algorithm>
#include <cassert>
#include <string>

#include "common/codec/band.h"
#include "common/codec/chain.h"
#include "common/codec/fixed.h"

namespace eigencast {
namespace {

constexpr std::uint8_t kVersion = 1;

Error corrupt_segment(const char* what) {
  return fail(ErrorCode::kCorrupt, std::string("memory segment: ") + what);
}
Error segment_misuse(std::string what) {
  return fail(ErrorCode::kInvalidArgument, "memory segment: " + std::move(what));
}

void append_layout(const CoefficientLayout& layout, ByteWriter& writer) {
  writer.u8(static_cast<std::uint8_t>(layout.channels));
  writer.u8(static_cast<std::uint8_t>(layout.band_ends.size()));
  for (const std::uint32_t end : layout.band_ends) writer.varint(end);
}

bool reads_layout(const CoefficientLayout& layout, ByteReader& reader) {
  bool same = reader.u8() == layout.channels && reader.u8() == layout.band_ends.size();
  for (const std::uint32_t end : layout.band_ends) same = same && reader.varint() == end;
  return same;
}

}  // namespace

Result<void> PoseMemory::check_size(const CoefficientLayout& layout, std::uint64_t poses) {
  const std::size_t bytes = layout.size() * sizeof(std::int32_t);
  if (poses <= kMaxPoses && poses * bytes <= kMaxBytes) return {};
  return fail(ErrorCode::kTooLarge, "memory: " + std::to_string(poses) + " poses: 1,024, and 8 MiB, are the most");
}

Result<CodedSegment> encode_segment(const CoefficientLayout& layout, const AssetDigest& asset,
                                    std::span<const Key> poses, std::uint8_t half_spacing) {
  if (layout.is_float()) return segment_misuse("a float codec has no memory");
  if (poses.empty()) return segment_misuse("it has no pose");
  if (half_spacing < 1) return segment_misuse("a half spacing is at least a step");
  if (auto checked = PoseMemory::check_size(layout, poses.size()); !checked) return checked.error();
  auto segment = std::make_shared<MemorySegment>();
  segment->step = poses.front().step;
  CodedSegment out;
  ByteWriter writer(out.bytes);
  writer.bytes(kSegmentMagic);
  writer.u8(kVersion);
  writer.bytes(asset);
  append_layout(layout, writer);
  writer.varint(poses.size());
  std::optional<ChainState> state;
  for (const Key& pose : poses) {
    if (pose.step != segment->step || pose.bands != layout.all_bands())
      return segment_misuse("its poses differ in step, or lack bands");
    Bytes payload;
    if (!state) {
      state = advanced(std::nullopt, pose, 0);
      auto join = encode_join(layout, *state);
      if (!join) return join.error();
      payload = std::move(*join);
    } else {
      auto key = encode_key(layout, *state, pose, half_spacing);
      if (!key) return key.error();
      payload = std::move(key->payload);
      state = advanced(std::move(state), std::move(key->key), 0);
    }
    writer.varint(payload.size());
    writer.bytes(payload);
    segment->values.insert(segment->values.end(), state->newer.q.begin(), state->newer.q.end());
    ++segment->poses;
  }
  out.segment = std::move(segment);
  return out;
}

Result<std::shared_ptr<const MemorySegment>> decode_segment(const CoefficientLayout& layout, const AssetDigest& asset,
                                                            ByteView bytes) {
  if (layout.is_float()) return segment_misuse("a float codec has no memory");
  ByteReader reader(bytes);
  const ByteView magic = reader.bytes(kSegmentMagic.size());
  if (!std::equal(magic.begin(), magic.end(), kSegmentMagic.begin(), kSegmentMagic.end()))
    return corrupt_segment("it does not begin as one");
  const std::uint8_t version = reader.u8();
  if (version != kVersion) return fail(ErrorCode::kUnsupported, "memory segment: another version than 1");
  const ByteView of = reader.bytes(asset.size());
  if (reader.failed() || !std::equal(of.begin(), of.end(), asset.begin()))
    return corrupt_segment("it belongs to another asset");
  if (!reads_layout(layout, reader)) return corrupt_segment("its layout is not the stream's");
  const std::uint64_t poses = reader.varint();
  if (reader.failed()) return corrupt_segment("it ends within its head");
  if (const auto checked = PoseMemory::check_size(layout, poses); !checked) return checked.error();
  // A pose takes at least a length and a byte for each band.
  if (poses == 0 || poses > reader.remaining()) return corrupt_segment("it has fewer poses than it says");
  auto segment = std::make_shared<MemorySegment>();
  segment->poses = static_cast<std::uint32_t>(poses);
  segment->values.reserve(poses * layout.size());
  std::optional<ChainState> state;
  for (std::uint64_t pose = 0; pose < poses; ++pose) {
    const ByteView payload = reader.bytes(reader.varint());
    if (reader.failed()) return corrupt_segment("it ends within a pose");
    if (!state) {
      auto joined = decode_join(layout, layout.all_bands(), payload);
      if (!joined) return in_context("memory segment", joined.error());
      state = std::move(*joined);
      segment->step = state->newer.step;
    } else {
      auto key = decode_key(layout, layout.all_bands(), *state, payload);
      if (!key) return in_context("memory segment", key.error());
      if (key->step != segment->step) return corrupt_segment("a pose of another step than the first");
      state = advanced(std::move(state), std::move(*key), 0);
    }
    segment->values.insert(segment->values.end(), state->newer.q.begin(), state->newer.q.end());
  }
  if (!reader.finished()) return corrupt_segment("bytes are left over");
  return std::shared_ptr<const MemorySegment>(std::move(segment));
}

Result<PoseMemory> PoseMemory::with(std::shared_ptr<const MemorySegment> segment) const {
  PoseMemory grown = *this;
  if (auto added = grown.add(std::move(segment)); !added) return added.error();
  return grown;
}

Result<void> PoseMemory::add(std::shared_ptr<const MemorySegment> segment) {
  assert(segment && segment->poses > 0 && segment->values.size() == segment->poses * layout_.size());
  const std::uint32_t start = pose_count();
  if (auto checked = check_size(layout_, std::uint64_t{start} + segment->poses); !checked) return checked;
  segments_.push_back(std::move(segment));
  starts_.push_back(start);
  return {};
}

std::size_t PoseMemory::segment_of(std::uint32_t pose) const {
  return static_cast<std::size_t>(std::upper_bound(starts_.begin(), starts_.end(), pose) - starts_.begin()) - 1;
}

bool PoseMemory::has(std::uint64_t phase) const {
  const std::uint64_t pose = phase / kParts;
  if (pose >= pose_count()) return false;
  if (phase % kParts == 0) return true;
  const std::size_t s = segment_of(static_cast<std::uint32_t>(pose));
  return pose + 1 < std::uint64_t{starts_[s]} + segments_[s]->poses;
}

std::span<const std::int32_t> PoseMemory::pose(std::uint32_t pose) const {
  const std::size_t s = segment_of(pose);
  return std::span(segments_[s]->values).subspan((pose - starts_[s]) * layout_.size(), layout_.size());
}

bool PoseMemory::recall(std::uint32_t phase, std::uint8_t step, std::size_t first, std::span<std::int32_t> out) const {
  assert(has(phase) && first + out.size() <= layout_.size());
  const std::uint32_t at = phase / kParts;
  const std::size_t s = segment_of(at);
  const MemorySegment& segment = *segments_[s];
  const std::int64_t f = phase % kParts, rest = kParts - f;
  // Poses beyond the ends of the segment are as those at the ends.
  const std::uint32_t i = at - starts_[s], end = segment.poses - 1;
  const auto values = [&](std::uint32_t pose) {
    return segment.values.data() + std::min(pose, end) * layout_.size() + first;
  };
  const std::int32_t *before = values(i == 0 ? 0 : i - 1), *from = values(i), *to = values(i + 1),
                     *after = values(i + 2);
  // In units of 1 / (2 * 8^3).
  const std::int64_t w0 = -f * rest * rest, w1 = (3 * f - 40) * f * f + 1024, w2 = (32 - 3 * f) * f * f + 64 * f,
                     w3 = -f * f * rest;
  const fixed::Rescale rule(segment.step, step);
  bool in_range = true;
  for (std::size_t k = 0; k < out.size(); ++k) {
    std::int64_t value = from[k];
    if (f != 0) value = (w0 * before[k] + w1 * from[k] + w2 * to[k] + w3 * after[k] + 512) >> 10;
    in_range &= fixed::in_range(value);
    if (segment.step != step) value = fixed::in_range(value) ? rule(value) : 0;
    in_range &= fixed::in_range(value);
    out[k] = static_cast<std::int32_t>(value);
  }
  return in_range;
}

}  // namespace eigencast
