// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "common/codec/pose_memory.h"
#include "common/core/hash/sha256.h"
#include "common/recording/reader.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/frame_decoder.h"

namespace eigencast {

struct RecordedPose {
  Key key;
  Bytes coded;                         ///< As a key of its chain; empty: it was a join.
  std::optional<std::uint32_t> phase;  ///< Where in the memory it was predicted from, if it was.
  TimeUs capture_us = 0;               ///< On the sender's clock.
};

/// The stream that a recording holds (docs/recording-format.md), decoded, from the beginning or from any time on.
///
/// Safe on hostile input. Not thread-safe.
class RecordedStream {
 public:
  using Memory = std::vector<CodedSegment>;  ///< The whole memory of the poses that follow.
  struct Event {
    TimeUs time_us = 0;  ///< Since the start of the recording.
    std::variant<control::Announce, Memory, RecordedPose> what;
  };

  /// Errors: those of recording::Reader.
  static Result<RecordedStream> open(const std::string& path);

  const recording::Info& info() const { return reader_.info(); }

  /// The next announcement, memory or new pose; nothing at the end. What a gap makes undecodable is passed over.
  /// Errors: those of recording::Reader and decode_segment; kCorrupt, kUnsupported (a format that is none of ours).
  Result<std::optional<Event>> next();
  /// To the last checkpoint at or before time_us; its announcement and memory come first. Errors: kCorrupt.
  Result<void> seek(TimeUs time_us);

  /// Of the poses since the last announcement.
  const CoefficientLayout& layout() const { return decoder_.layout(); }
  std::vector<double> coefficients(const Key& key) const { return decoder_.coefficients(key); }

  /// An object of an asset or a memory. Errors: kNotFound (the recording has none of that hash), kCorrupt.
  Result<Bytes> object(const Sha256& id);

 private:
  RecordedStream(recording::Reader reader, std::map<Sha256, std::uint64_t> objects)
      : reader_(std::move(reader)), objects_(std::move(objects)) {}
  Result<control::Announce> begin(const Bytes& text);
  Result<Memory> remember(ByteView ids);
  Result<std::optional<RecordedPose>> pose(ByteView frame);

  recording::Reader reader_;
  std::map<Sha256, std::uint64_t> objects_;  ///< Where they are.
  std::optional<Sha256> asset_;
  std::uint32_t epoch_ = 0;  ///< The announcements until now.
  EnvelopeReader envelopes_;
  std::optional<ChainClock> newest_;  ///< Of the poses given.
  FrameDecoder decoder_;
};

}  // namespace eigencast
