// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <utility>

#include "common/codec/chain.h"
#include "common/codec/key.h"
#include "common/codec/pose_memory.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"

namespace eigencast {

/// A receiver's end of one stream's key chain (docs/protocol.md): a key s is decodable when the newest key is s-1, a
/// step up to s or an estimate beyond it when the newest key is s; a join always. Whatever is not waits for the next
/// join. Pure: no thread, no clock, no socket. Not thread-safe.
class FrameDecoder {
 public:
  struct Counts {
    std::uint64_t keys = 0;       ///< Decoded, each once, however many joins repeat it.
    std::uint64_t synthetic = 0;  ///< Poses made between keys or beyond them, also those that keys sent ahead show.
    std::uint64_t joins = 0;
    std::uint64_t rejected = 0;  ///< Frames that could not be decoded.
    std::uint64_t missed = 0;    ///< Key sequence numbers never seen.
  };

  void set_stream(const control::StreamInfo& info);  ///< Another stream or epoch starts the chain anew.
  void restart() { chain_.reset(); }
  /// What keys may be predicted from until the next call, or another stream or epoch. Without: the chain is nowhere in
  /// the next memory, which may have other poses. REQUIRES: of layout().
  void set_memory(std::optional<PoseMemory> memory) {
    memory_ = std::move(memory);
    if (chain_ && !memory_) chain_->phase.reset();
  }
  /// From one segment more, too. Errors: kTooLarge, which changes nothing. REQUIRES: of layout().
  Result<void> remember(std::shared_ptr<const MemorySegment> segment);

  /// The pose to show, valid until the next call; null when there is none (another stream or epoch, no state yet, a key
  /// sent ahead that shows none, a join of the very key that was shown last: a finer one is shown). Errors: kCorrupt,
  /// those of the codec; after a key the chain waits for a join.
  Result<const Key*> decode(const FrameView& frame);
  /// The newest key if it was sent ahead and not taken yet: poses that lead up to it follow. Valid until decode().
  const Key* take_ahead() { return std::exchange(ahead_, false) && chain_ ? &chain_->newer : nullptr; }
  TimeUs newest_capture_us() const { return newest_capture_us_; }
  /// Where in the memory the newest key was predicted from, if it was.
  std::optional<std::uint32_t> phase() const { return chain_ ? chain_->phase : std::nullopt; }

  const CoefficientLayout& layout() const { return layout_; }
  std::vector<double> coefficients(const Key& key) const;  ///< r x c, scalars in the sender's units.
  const Counts& counts() const { return counts_; }
  std::optional<std::uint64_t> newest() const { return chain_ ? std::optional(newest_) : std::nullopt; }

 private:
  Result<const Key*> apply(const FrameView& frame);
  Result<CodedKey> read_key(const FrameView& frame) const;
  Result<Key> made_pose(const FrameView& frame) const;
  Result<const Key*> shown(Result<Key> made);

  CoefficientLayout layout_;
  VelocityChannels velocities_;
  std::vector<double> scales_;                         ///< Of the channels from the fourth on.
  Profile::Scheme scheme_ = Profile::Scheme::kLinear;  ///< Belongs to the profile that the stream comes in.
  std::uint32_t stream_id_ = 0;
  std::uint32_t epoch_ = 0;
  bool has_stream_ = false;
  std::optional<ChainState> chain_;
  std::optional<PoseMemory> memory_;
  Key made_;                  ///< The last pose between keys or beyond them.
  std::uint64_t newest_ = 0;  ///< Sequence of chain_->newer.
  TimeUs newest_capture_us_ = 0;
  bool ahead_ = false;
  bool newest_shown_ = false;  ///< chain_->newer was given out itself, not only poses that lead up to it.
  std::optional<std::uint64_t> last_seen_;  ///< Newest key of this epoch, also over restarts.
  Counts counts_;
};

}  // namespace eigencast
