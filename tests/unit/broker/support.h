// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "broker/relay/stream.h"
#include "common/codec/chain.h"
#include "common/codec/schemes.h"
#include "common/wire/envelope.h"

namespace eigencast::broker::testing {

/// A small stream of two bands and its announcement.
CoefficientLayout small_layout();
control::Announce small_announce();

/// The key number `i` of a motion that is no straight line.
Key key_number(int i);

/// A sender without a network: the messages that it would send.
class FakeSender : public PublisherLink {
 public:
  /// The next key as a message: a join at the chain's start, a key afterwards.
  Bytes next(TimeUs capture_us);
  /// Begins a new chain at the next key.
  void begin_anew() { state_.reset(); }
  void skip_number() { ++sequence_; }
  void on_watcher_count(std::uint32_t count) override { counts.push_back(count); }

  std::vector<std::uint32_t> counts;

 private:
  std::uint64_t sequence_ = 0;
  TimeUs last_us_ = 0;
  std::optional<ChainState> state_;
};

/// A receiver that holds to the rules of docs/protocol.md and says so when a frame cannot be decoded.
class FakeReceiver : public Watcher {
 public:
  struct Pose {
    Envelope envelope;
    Key key;
  };

  void on_stream_changed(const Stream& stream, bool restart) override;
  void on_frame(const Stream&, const FramePtr& frame) override;
  void on_trace(const std::shared_ptr<const std::string>& text) override;

  void decode(const Frame& frame);

  std::vector<control::StreamInfo> infos;
  std::vector<FramePtr> frames;
  std::vector<Pose> poses;  ///< Shown: without those marked kAhead.
  std::vector<std::string> traces;
  int undecodable = 0;

 private:
  void decode_key_frame(const Envelope& head, ByteView payload);
  void show(const Envelope& head, const Key& key);
  /// A pose that came without a payload, by the rules of the profile.
  Result<Key> made(const Envelope& head) const;

  std::optional<ChainState> state_;
  std::uint64_t newest_ = 0;
  TimeUs newest_us_ = 0;
};

}  // namespace eigencast::broker::testing
