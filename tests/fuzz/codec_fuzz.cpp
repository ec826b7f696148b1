// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/codec/chain.h"
#include "common/codec/key.h"
#include "tests/fuzz/codec_bytes.h"

using namespace eigencast;

namespace {

void check_state(const CoefficientLayout& layout, const ChainState& state) {
  const auto payload = encode_join(layout, state);
  require(payload.has_value());
  const auto decoded = decode_join(layout, state.newer.bands, *payload);
  require(decoded.has_value() && decoded->newer == state.newer);
  require(encode_join(layout, *decoded).value() == *payload);
}

void check_key(const CoefficientLayout& layout, const ChainState& state, const Key& key, std::uint8_t half_spacing) {
  const auto coded = encode_key(layout, state, key, half_spacing);
  require(coded.has_value());
  require(half_spacing != 0 || coded->key == key);
  require(decode_key(layout, key.bands, state, coded->payload).value() == coded->key);
  if (key.step != state.newer.step) return;
  const Key& base = state.newer;
  const auto rest = encode_residual(layout, base, key, half_spacing);
  require(rest.has_value() && base.bands.includes(rest->bands));
  if (rest->bands.empty()) return;
  const auto pose = decode_residual(layout, rest->bands, base, rest->payload);
  require(pose.has_value() && pose->bands == base.bands);
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!(base.bands & key.bands).has(band)) continue;
    const auto [first, last] = layout.range(band);
    for (std::size_t i = first; i < last; ++i)
      require(layout.is_float() ? pose->f[i] == key.f[i]
                                : std::abs(std::int64_t{pose->q[i]} - key.q[i]) <= half_spacing);
  }
}

/// Poses of all schemes: either there is none, or it is a key like any other.
void check_made(const CoefficientLayout& layout, const ChainState& state, ByteReader& reader,
                std::uint8_t half_spacing) {
  const std::uint32_t at = 1u + reader.u8() % 15, of = 1u + reader.u8() % 15;
  const VelocityChannels velocities{reader.u8() % (layout.channels / 2 + 1), 1 + reader.u32() % 10'000'000};
  const auto check = [&](const Result<Key>& pose) {
    if (pose && !pose->bands.empty()) check_key(layout, state, *pose, half_spacing);
  };
  check(estimate_keys(layout, state.older, state.newer, (reader.u8() & 1) != 0, at, of));
  if (at <= of) check(interpolate_keys(layout, state.older, state.newer, at, of));
  if (at <= of) check(hermite_keys(layout, velocities, state.older, state.newer, state.age_us, at, of));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ByteReader reader(ByteView(data, size));
  const CoefficientLayout layout = layout_from(reader);
  const ChainState state{key_from(layout, reader), key_from(layout, reader), static_cast<TimeUs>(reader.u32())};
  check_state(layout, state);
  const std::uint8_t half_spacing = reader.u8() % 64;
  check_key(layout, state, key_from(layout, reader), half_spacing);
  check_made(layout, state, reader, half_spacing);

  const BandMask bands = reader.u8();
  const std::uint8_t keep = reader.u8();
  const ByteView payload = reader.bytes(reader.remaining());
  if (const auto pose = decode_residual(layout, bands, state.newer, payload))
    require(pose->bands == state.newer.bands && pose->step == state.newer.step);
  if (const auto key = decode_key(layout, bands, state, payload)) {
    check_key(layout, state, *key, 0);
    if ((bands & keep) != 0) require(cut_bands(layout, false, bands, keep, payload).has_value());
  }
  if (const auto joined = decode_join(layout, bands, payload)) {
    check_state(layout, *joined);
    if (const auto cut = cut_bands(layout, true, bands, keep, payload)) {
      require(decode_join(layout, bands & keep, *cut).has_value());
    }
  }
  return 0;
}
