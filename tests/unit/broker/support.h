// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "broker/relay/stream.h"
#include "common/codec/chain.h"
#include "common/codec/key.h"
#include "common/codec/pose_memory.h"
#include "common/core/hash/sha256.h"
#include "common/wire/envelope.h"

namespace eigencast::broker::testing {

inline constexpr TimeUs kInterval = 30'000;

inline const Profile kRaw{Profile::Rate::kRaw};
inline const Profile kLinear{};
inline const Profile kCurved{Profile::Rate::kInterpolated, 3, 8, Profile::Scheme::kCatmullRom};

/// A small stream of two bands and its announcement.
CoefficientLayout small_layout();
control::Announce small_announce();

/// A stream of 32,768 coefficients, and the messages of its sender: a join, then keys that change nothing, all short.
control::Announce large_announce();
Bytes large_message(const Stream& stream, std::uint64_t sequence, TimeUs capture_us);

/// The bytes of a manifest of no surface that lists these chunks.
Bytes manifest_of(const std::vector<Sha256>& chunks);

/// Key number `i` of a curved motion.
Key key_number(int i);

/// Poses that the FakeSender sends.
Generation::Segment segment_of(int first, int count, const AssetDigest& asset = {});

/// The messages of a sender, without a network.
class FakeSender : public PublisherLink {
 public:
  /// The next key as a message: a join at the chain's start, a key afterwards.
  Bytes next(TimeUs capture_us);
  /// The same, predicted from `memory` at a phase: not exactly.
  Bytes next_recalled(TimeUs capture_us, const PoseMemory& memory, std::uint32_t phase);
  /// The next key as the join that carries its chain on in an epoch of this tag.
  Bytes carry_on(std::uint8_t of, TimeUs capture_us);
  /// What its memory is void of now.
  void forget_phase() { state_->phase.reset(); }
  const Key& sent() const { return state_->newer; }
  /// Begins a new chain at the next key.
  void begin_anew() { state_.reset(); }
  void skip_number() { ++sequence_; }
  void on_watcher_count(std::uint32_t count) override { counts.push_back(count); }

  std::vector<std::uint32_t> counts;
  std::uint8_t tag = 1;  ///< Of its stream's epoch: new ones count from 1.

 private:
  Bytes framed(FrameKind kind, std::uint8_t flags, TimeUs capture_us, const Bytes& payload);

  std::uint64_t sequence_ = 0;
  TimeUs last_us_ = 0;
  std::optional<ChainState> state_;
};

/// Something that `most` may hold at a time.
class FakeAccount {
 public:
  explicit FakeAccount(std::size_t most = 1000) : most_(most) {}
  Charge charge() {
    return [this]() -> Result<std::shared_ptr<void>> {
      if (held() >= most_) return fail(ErrorCode::kRefused, "no more");
      return std::shared_ptr<void>(held_);
    };
  }
  std::size_t held() const { return static_cast<std::size_t>(held_.use_count()) - 1; }

 private:
  const std::size_t most_;
  const std::shared_ptr<int> held_ = std::make_shared<int>();
};

/// A receiver that follows docs/protocol.md and counts frames that it cannot decode.
class FakeReceiver : public Watcher {
 public:
  explicit FakeReceiver(std::string holder = {}) : holder_(std::move(holder)) {}
  std::string holder() const override { return holder_; }
  struct Pose {
    Envelope envelope;
    Key key;
  };

  void on_stream_changed(const Stream& stream, bool restart) override;
  void on_restart(const Stream& stream) override;
  void on_frames(const Stream&, std::span<const FramePtr> received) override;
  void on_trace(const std::shared_ptr<const std::string>& text) override;

  bool charge_poses(double work_us) override {
    charged_us += work_us;
    return charged_us < budget_us;
  }

  const void* purse() const override { return shared != nullptr ? shared : this; }

  virtual void on_frame(const FramePtr& frame);
  void decode(const Frame& frame);

  std::vector<control::StreamInfo> infos;
  std::vector<FramePtr> frames;
  std::vector<Pose> poses;  ///< Shown ones: in place of a key sent ahead the step that it shows.
  std::vector<std::string> traces;
  int undecodable = 0;
  std::optional<PoseMemory> memory;
  double charged_us = 0, budget_us = 1e9;  ///< Of encoding poses.
  const void* shared = nullptr;            ///< With others.

 private:
  void show(const Envelope& head, const Key& key);
  /// A pose computed by the profile's rules.
  Result<Key> made(const Envelope& head) const;

  std::string holder_;
  EnvelopeReader reader_;
  bool reads_ = false;  ///< It knows its stream, so that `reader_` must find the envelopes of frames.
  std::optional<ChainState> state_;
  std::uint64_t newest_ = 0;
  TimeUs newest_us_ = 0;
};

}  // namespace eigencast::broker::testing
