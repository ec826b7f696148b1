// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "broker/relay/stream.h"
#include "common/codec/chain.h"
#include "common/codec/schemes.h"
#include "common/wire/envelope.h"

namespace eigencast::broker::testing {

/// A small stream of two bands and its announcement.
inline CoefficientLayout small_layout() {
  return {CodecKind::kQuantised, 8, 3, {4, 8}};
}

inline control::Announce small_announce() {
  control::Announce announce;
  announce.asset = std::string(64, 'a');
  announce.format = {8, 3, {4, 8}, "quantised"};
  announce.key_rate_hz = 30;
  return announce;
}

/// The key number `i` of a motion that is no straight line.
inline Key key_number(int i) {
  Key key;
  key.bands = 3;
  key.step = 100;
  key.q.resize(24);
  for (int j = 0; j < 24; ++j) key.q[static_cast<std::size_t>(j)] = (i * i * (j + 1)) % 977 - 400 + 7 * j;
  return key;
}

/// A sender without a network: the messages that it would send.
class FakeSender : public PublisherLink {
 public:
  /// The next key as a message: a join at the chain's start, a key afterwards.
  Bytes next(TimeUs capture_us) {
    const Key key = key_number(static_cast<int>(sequence_));
    Envelope head;
    head.sequence = sequence_++;
    head.capture_us = capture_us;
    head.bands = 3;
    head.kind = state_ ? FrameKind::kKey : FrameKind::kJoin;
    Bytes message;
    if (state_) {
      const Bytes payload = encode_key(small_layout(), *state_, key, 0).value().payload;
      state_ = advanced(state_, key, capture_us - last_us_);
      append_envelope(head, message);
      message.insert(message.end(), payload.begin(), payload.end());
    } else {
      state_ = advanced({}, key, 0);
      const Bytes payload = encode_join(small_layout(), *state_).value();
      append_envelope(head, message);
      message.insert(message.end(), payload.begin(), payload.end());
    }
    last_us_ = capture_us;
    return message;
  }
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

  void on_stream_changed(const Stream& stream, bool restart) override {
    infos.push_back(stream.info_for(*this));
    if (restart) state_.reset();
  }
  void on_frame(const Stream&, const FramePtr& frame) override {
    frames.push_back(frame);
    decode(*frame);
  }
  void on_trace(const std::shared_ptr<const std::string>& text) override {
    const bool short_one = static_cast<unsigned char>((*text)[1]) < 126;
    traces.push_back(text->substr(short_one ? 2 : 4));
  }

  void decode(const Frame& frame) {
    const auto view = parse_frame(frame.message());
    if (!view) return void(++undecodable);
    const Envelope& head = view->envelope;
    const CoefficientLayout layout = small_layout();
    if (head.kind == FrameKind::kJoin) {
      auto state = decode_join(layout, head.bands, view->payload);
      if (!state) return void(++undecodable);
      state_ = *state;
      newest_ = head.sequence;
      newest_us_ = head.capture_us;
      show(head, state_->newer);
    } else if (head.kind == FrameKind::kStep || head.kind == FrameKind::kEstimate) {
      if (!state_ || head.sequence != newest_) return void(++undecodable);
      const auto key = head.bands == 0 ? made(head) : decode_key(layout, head.bands, *state_, view->payload);
      if (!key) return void(++undecodable);
      show(head, *key);
    } else {
      if (!state_ || head.sequence != newest_ + 1) return void(++undecodable);
      auto key = decode_key(layout, head.bands, *state_, view->payload);
      if (!key) return void(++undecodable);
      show(head, *key);
      if (head.kind == FrameKind::kSynthetic) return;
      state_ = advanced(state_, *key, head.capture_us - newest_us_);
      newest_ = head.sequence;
      newest_us_ = head.capture_us;
    }
  }

  std::vector<control::StreamInfo> infos;
  std::vector<FramePtr> frames;
  std::vector<Pose> poses;  ///< Shown: without those marked kAhead.
  std::vector<std::string> traces;
  int undecodable = 0;

 private:
  void show(const Envelope& head, const Key& key) {
    if ((head.flags & Envelope::kAhead) == 0) poses.push_back({head, key});
  }
  /// A pose that came without a payload, by the rules of the profile.
  Result<Key> made(const Envelope& head) const {
    const auto [at, of] = head.step;
    const auto& [older, newer, age_us] = *state_;
    const Profile::Scheme scheme = infos.back().profile.scheme;
    const StreamFormat& format = infos.back().format;
    if (head.kind == FrameKind::kEstimate)
      return estimate_keys(small_layout(), older, newer, scheme == Profile::Scheme::kDamped, at, of);
    if (scheme != Profile::Scheme::kHermite) return interpolate_keys(small_layout(), older, newer, at, of);
    return hermite_keys(small_layout(), {format.velocity_channels, format.velocity_us}, older, newer, age_us, at, of);
  }

  std::optional<ChainState> state_;
  std::uint64_t newest_ = 0;
  TimeUs newest_us_ = 0;
};

}  // namespace eigencast::broker::testing
