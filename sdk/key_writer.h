// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "common/codec/chain.h"
#include "common/codec/pose_memory.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/send_policy.h"

namespace eigencast {

/// A sender's end of one stream's key chain (docs/protocol.md). What did not leave changes nothing. Pure: no thread, no
/// clock, no socket. Not thread-safe.
class KeyWriter {
 public:
  /// A key as the next message, and the chain's state once it is written.
  struct Coded {
    Bytes message;
    ChainState next;
    TimeUs capture_us = 0;
  };

  /// As encode_key.
  using Coder = std::function<Result<CodedKey>(const ChainState& state, const Key& key, std::uint8_t half_spacing)>;

  /// half_spacing  of coded levels (see encode_key) while nothing else is said by `rate`, where a bit rate is kept
  /// coarse_half_spacing  instead, but for keys behind one that was predicted from a memory: these are predicted from
  ///                      it, too, mostly, and take few bits; 0: the same
  KeyWriter(CoefficientLayout layout, std::uint8_t half_spacing, std::optional<RateControl> rate,
            std::uint8_t coarse_half_spacing = 0);

  /// The next message is the first of a stream that the broker knows by these.
  void begin(const control::Announced& announced);
  /// The same, and the first message carries on a chain that ended at `newest`.
  ///   older  its last key in this layout; nothing: it had none
  void continue_as(const control::Announced& announced, const ChainClock& newest, std::optional<Key> older);
  const ChainClock& newest() const { return newest_; }
  void restart() { chain_.reset(), older_.reset(); }  ///< The chain is broken: the next message is a join.
  /// Codes the keys to come from a memory, as Recaller::encode does; nothing: by encode_key. `continues`: the memory
  /// has all poses of the one before.
  void code_by(Coder coder, std::optional<PoseMemory> memory, bool continues);

  Result<Coded> code(Key key, TimeUs capture_us) const;  ///< Errors: those of the codec.
  /// The same, with the payload that it had in another chain where that gives the same key in this one: exactly.
  ///   phase  where in the memory it was predicted from there, if it was
  Result<Coded> code_as(Key key, ByteView payload, std::optional<std::uint32_t> phase, TimeUs capture_us) const;
  void sent(Coded coded, std::size_t bytes);

  const ChainState* state() const { return chain_ ? &*chain_ : nullptr; }  ///< Null before the first of a chain.
  const Key* held() const { return chain_ ? &chain_->newer : nullptr; }    ///< Likewise.
  /// Of the next key.
  std::uint8_t half_spacing() const {
    if (rate_) return rate_->choice().half_spacing;
    return chain_ && chain_->phase ? half_spacing_ : coarse_half_spacing_;
  }
  bool may_follow(TimeUs capture_us) const { return (!chain_ && !older_) || capture_us > newest_.capture_us; }
  const CoefficientLayout& layout() const { return layout_; }
  std::uint32_t stream_id() const { return announced_.stream_id; }
  std::uint32_t epoch() const { return announced_.epoch; }
  std::uint64_t sequence() const { return newest_.sequence; }  ///< Numbers the last key written in this epoch.
  std::vector<double> positions_held() const;                  ///< r x 3 of held(); empty where there is none.

 private:
  Coded framed(CodedKey coded, TimeUs capture_us) const;
  Coded framed(FrameKind kind, ByteView payload, ChainState next, TimeUs capture_us) const;

  const CoefficientLayout layout_;
  const std::uint8_t half_spacing_, coarse_half_spacing_;
  std::optional<RateControl> rate_;
  Coder coder_;
  std::optional<PoseMemory> memory_;  ///< The coder's.
  std::optional<ChainState> chain_;   ///< Nothing until the first message of a chain.
  std::optional<Key> older_;          ///< Of the chain that the first message carries on.
  control::Announced announced_;
  ChainClock newest_;
};

}  // namespace eigencast
