// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/codec/key.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"

namespace eigencast {

class PoseMemory;

/// The state of coder and decoder: the last two keys (keyframes). At the first key of a chain older == newer.
struct ChainState {
  Key older;
  Key newer;
  TimeUs age_us = 0;                     ///< Capture time of newer minus capture time of older; 0 at the first key.
  std::optional<std::uint32_t> phase{};  ///< Where in the memory `newer` was predicted from, if it was.
  bool operator==(const ChainState&) const = default;
};

/// After one more key: newer becomes older. With no state, both are `key`.
ChainState advanced(std::optional<ChainState> state, Key key, TimeUs age_us, std::optional<std::uint32_t> phase = {});

struct CodedKey {
  Bytes payload;
  Key key;                               ///< As decoded: the next state is made of it on both sides.
  std::optional<std::uint32_t> phase{};  ///< Set where a memory predicts it: the frame needs the flag.
};

/// Payload of a kKey frame: `key`, predicted from `state`, which is not changed. Each band is
/// self-contained.
///   half_spacing  m, 0..63: bands of the state's newer key are coded to within about 0.56 m steps rms; 0: exactly.
///                 Other bands and float codecs are always exact.
/// Errors: kInvalidArgument (the key does not fit the layout, or has no band; m), kTooLarge (beyond +-2^30 or float32).
Result<CodedKey> encode_key(const CoefficientLayout& layout, const ChainState& state, const Key& key,
                            std::uint8_t half_spacing);

/// The same, predicted from a memory as well, at a phase that it has: payload of a kKey frame with the memory's flag.
/// In it a varint follows the step: the zigzag code of the phase minus the state's, or minus 0.
/// Errors: also kInvalidArgument (a float codec, m of 0, a phase beyond the memory), kTooLarge (the memory's pose
/// leaves the range at the key's step: use encode_key).
Result<CodedKey> encode_recalled_key(const CoefficientLayout& layout, const ChainState& state, const PoseMemory& memory,
                                     std::uint32_t phase, const Key& key, std::uint8_t half_spacing);

struct CodedResidual {
  BandMask bands;  ///< None: a step says the pose without payload.
  Bytes payload;
};

/// Payload of a kStep frame: what makes of `base`, the pose that receivers interpolate themselves, `pose`. Leaves out
/// the bands that are within half a spacing of it already, and those that one of the two lacks.
///   half_spacing  m, 0..63: decoded values are within m steps of the pose; 0, and float codecs: exact.
/// Errors: kInvalidArgument (base and pose do not fit the layout, or differ in step; m), kTooLarge as encode_key.
Result<CodedResidual> encode_residual(const CoefficientLayout& layout, const Key& base, Key pose,
                                      std::uint8_t half_spacing);
/// The pose. `bands` is the envelope's. Safe on hostile input. Errors: as decode_key; kCorrupt (a band that `base`
/// lacks, another step). REQUIRES: `base` fits the layout.
Result<Key> decode_residual(const CoefficientLayout& layout, BandMask bands, Key base, ByteView payload);

/// The m of a payload that decode_key has taken.
std::uint8_t half_spacing_of(ByteView payload);

/// `bands` is the envelope's. Safe on hostile input: never allocates more than the layout says. Errors: kCorrupt
/// (codec, lengths, trailing or missing bytes, a band that needs a state which lacks it, overflow).
Result<Key> decode_key(const CoefficientLayout& layout, BandMask bands, const ChainState& state, ByteView payload);

struct RecalledKey {
  Key key;
  std::uint32_t phase;
};
/// Reads what encode_recalled_key writes. Safe on hostile input. Errors: as decode_key; kCorrupt (a phase beyond the
/// memory). REQUIRES: `memory` is of `layout`.
Result<RecalledKey> decode_recalled_key(const CoefficientLayout& layout, BandMask bands, const ChainState& state,
                                        const PoseMemory& memory, ByteView payload);

/// Payload of a kJoin frame: both keys, without prediction or age_us; with the phase if there is one (a varint behind
/// older_bands), which then needs the memory's flag. Omits bands of the older key alone, which nothing
/// can use. Errors: as encode_key.
Result<Bytes> encode_join(const CoefficientLayout& layout, const ChainState& state);
/// age_us is 0: the envelope has it. `recalled`: the memory's flag. Errors: as decode_key.
Result<ChainState> decode_join(const CoefficientLayout& layout, BandMask bands, ByteView payload,
                               bool recalled = false);

/// The payload with only the bands of `keep`, without decoding a value. `join`: of a kJoin frame, else of a kKey.
/// `recalled`: the memory's flag. Errors: kCorrupt, kInvalidArgument (no band would remain).
Result<Bytes> cut_bands(const CoefficientLayout& layout, bool join, BandMask bands, BandMask keep, ByteView payload,
                        bool recalled = false);

}  // namespace eigencast
