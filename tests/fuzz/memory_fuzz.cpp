// SPDX-License-Identifier: MIT
#include "common/codec/pose_memory.h"
#include "common/codec/recaller.h"
#include "tests/fuzz/codec_bytes.h"

using namespace eigencast;

namespace {

constexpr AssetDigest kAsset{7};

/// What a memory of arbitrary poses recalls is what its receivers recall, and a key that it predicts is decoded alike.
void check_memory(const PoseMemory& memory, const ChainState& start, const Key& key, std::uint8_t half_spacing) {
  const CoefficientLayout& layout = memory.layout();
  Recaller recaller(memory);
  ChainState state = start;
  for (int frame = 0; frame < 3; ++frame) {
    const auto coded = recaller.encode(state, key, half_spacing);
    require(coded.has_value());
    if (coded->phase) {
      require(memory.has(*coded->phase));
      const auto decoded = decode_recalled_key(layout, key.bands, state, memory, coded->payload);
      require(decoded.has_value() && decoded->key == coded->key && decoded->phase == *coded->phase);
    } else {
      require(decode_key(layout, key.bands, state, coded->payload).value() == coded->key);
    }
    state = advanced(state, coded->key, 33'333, coded->phase);
    const auto join = encode_join(layout, state);
    const auto joined = decode_join(layout, state.newer.bands, join.value(), state.phase.has_value());
    require(joined.has_value() && joined->newer == state.newer && joined->phase == state.phase);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ByteReader reader(ByteView(data, size));
  const CoefficientLayout layout = layout_from(reader);
  const ChainState state{key_from(layout, reader), key_from(layout, reader), 1, reader.u8() % 64};
  const Key key = key_from(layout, reader);
  const auto half_spacing = static_cast<std::uint8_t>(1 + reader.u8() % 63);
  const BandMask bands = reader.u8(), keep = reader.u8();
  const ByteView payload = reader.bytes(std::min<std::size_t>(reader.u8(), reader.remaining()));
  PoseMemory memory(layout);
  // Poses of the writer's, then a segment of the network's.
  std::vector<Key> poses;
  for (unsigned count = reader.u8() % 4; poses.size() < count;) {
    Key pose = key_from(layout, reader);
    pose.bands = layout.all_bands();
    if (!poses.empty()) pose.step = poses.front().step;
    poses.push_back(std::move(pose));
  }
  if (const auto coded = encode_segment(layout, kAsset, poses, half_spacing)) {
    const auto decoded = decode_segment(layout, kAsset, coded->bytes);
    require(decoded.has_value() && (*decoded)->values == coded->segment->values);
    memory = memory.with(*decoded).value();
    Bytes damaged = coded->bytes;
    for (unsigned count = reader.u8() % 8; count > 0; --count) damaged[reader.u16() % damaged.size()] = reader.u8();
    if (const auto other = decode_segment(layout, kAsset, damaged)) {
      require((*other)->poses > 0 && (*other)->values.size() == (*other)->poses * layout.size());
      if (const auto grown = memory.with(*other)) memory = *grown;
    }
  }
  if (const auto segment = decode_segment(layout, kAsset, reader.bytes(reader.remaining()))) {
    if (const auto grown = memory.with(*segment)) memory = *grown;
  }
  ChainState start = state;
  if (layout.is_float() || !memory.has(*start.phase)) start.phase.reset();
  check_memory(memory, start, key, half_spacing);
  const auto got = decode_recalled_key(layout, bands, state, memory, payload);
  if (got) require(memory.has(got->phase) && got->key.bands == bands);
  if (got && !(bands & keep).empty()) require(cut_bands(layout, false, bands, keep, payload, true).has_value());
  if (const auto joined = decode_join(layout, bands, payload, true)) require(joined->phase.has_value());
  return 0;
}
