// SPDX-License-Identifier: MIT
//
// The poses of a stream, as each profile gives them.
#include "broker/relay/stream.h"

#include <cmath>
#include <functional>

#include "tests/unit/broker/relay/stream_scene.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using StreamPosesTest = StreamTest;

TEST_F(StreamPosesTest, RawDeliversExactlyWhatWasSent) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kRaw));
  begin();
  std::vector<Bytes> sent;
  for (int i = 0; i < 10; ++i) {
    sent.push_back(sender_.next(now_ + i * kInterval));
    ASSERT_TRUE(stream_.add_frame(sent.back(), now_));
  }
  ASSERT_EQ(receiver.frames.size(), sent.size());
  for (std::size_t i = 0; i < sent.size(); ++i) {
    const auto out = parse_frame(receiver.frames[i]->message()).value();
    const auto in = parse_frame(sent[i]).value();
    EXPECT_TRUE(std::equal(out.payload.begin(), out.payload.end(), in.payload.begin(), in.payload.end()));
    EXPECT_EQ(receiver.poses[i].envelope.capture_us, now_ + static_cast<TimeUs>(i) * kInterval);
    EXPECT_EQ(receiver.poses[i].envelope.sequence, i);
    EXPECT_EQ(out.envelope.stream_id, 7u);
    EXPECT_EQ(receiver.poses[i].envelope.epoch, 1u);
    EXPECT_EQ(receiver.poses[i].key, key_number(static_cast<int>(i)));
  }
}

TEST_F(StreamPosesTest, StepsInterpolateBetweenNeighbours) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kLinear));
  begin();
  play(11);
  wait(3 * kInterval);
  EXPECT_EQ(receiver.undecodable, 0);
  ASSERT_EQ(receiver.poses.size(), 1u + 3 * 10);
  for (const auto& pose : receiver.poses) {
    const int s = static_cast<int>(pose.envelope.sequence);
    const auto [at, of] = pose.envelope.step;
    if (pose.envelope.kind == FrameKind::kStep) {
      EXPECT_EQ(pose.key, interpolate_keys(small_layout(), key_number(s - 1), key_number(s), at, of).value());
      EXPECT_EQ(pose.envelope.capture_us, 1'000'000 + (s - 1) * kInterval + at * kInterval / of);
    } else {
      EXPECT_EQ(pose.key, key_number(s));
    }
  }
  for (std::size_t i = 1; i < receiver.poses.size(); ++i) {
    EXPECT_EQ(receiver.poses[i].envelope.capture_us - receiver.poses[i - 1].envelope.capture_us, kInterval / 3);
  }
}

/// Keys of one band, without a network, and what a viewer of them gets and is charged.
class LargeStream : public PublisherLink, public Watcher {
 public:
  LargeStream(std::uint32_t rows, std::uint32_t channels, std::uint8_t half_spacing)
      : layout_{CodecKind::kQuantised, rows, channels, {rows}}, half_spacing_(half_spacing) {
    control::Announce announce;
    announce.format = {rows, channels, {rows}, "quantised"};
    announce.key_rate_hz = 30;
    EXPECT_TRUE(stream_.claim(*this));
    EXPECT_TRUE(stream_.announce(announce, 1));
  }
  ~LargeStream() override {
    stream_.unwatch(*this);
    stream_.release(*this);
  }
  void watch(const Profile& profile) { ASSERT_TRUE(stream_.watch(*this, profile)); }
  /// Publishes a key each 33 ms; `value` of a key's number and a coefficient's. Returns the bytes of the last.
  std::size_t play(int keys, const std::function<double(int, int)>& value) {
    std::size_t bytes = 0;
    for (int i = 0; i < keys; ++i, ++number_) {
      Key key = empty_key(layout_, 1, 100);
      for (std::size_t j = 0; j < key.q.size(); ++j)
        key.q[j] = static_cast<std::int32_t>(std::lround(value(number_, static_cast<int>(j))));
      Envelope head;
      head.sequence = static_cast<std::uint64_t>(number_);
      head.capture_us = now_;
      head.bands = 1;
      head.kind = state_ ? FrameKind::kKey : FrameKind::kJoin;
      Bytes payload, message;
      if (state_) {
        CodedKey coded = encode_key(layout_, *state_, key, half_spacing_).value();
        payload = std::move(coded.payload);
        key = std::move(coded.key);
      }
      state_ = advanced(std::move(state_), key, 33'000);
      if (number_ == 0) payload = encode_join(layout_, *state_).value();
      head.tag = stream_.tag();
      const KeyRecordPtr& newest = stream_.snapshot().newest;
      const ChainClock clock = newest ? newest->clock() : ChainClock{};
      append_envelope(head, &clock, message);
      message.insert(message.end(), payload.begin(), payload.end());
      bytes = payload.size();
      EXPECT_TRUE(stream_.add_frame(message, now_));
      for (const TimeUs end = now_ + 33'000; now_ < end; now_ += 1000) stream_.pump(now_);
    }
    return bytes;
  }

  void on_watcher_count(std::uint32_t) override {}
  void on_stream_changed(const Stream&, bool) override {}
  void on_trace(const std::shared_ptr<const std::string>&) override {}
  void on_frames(const Stream&, std::span<const FramePtr> frames) override {
    for (const FramePtr& frame : frames) {
      if (frame->envelope.is_key()) continue;
      ++poses;
      pose_bytes += frame->wire.size();
    }
  }
  bool charge_poses(double work_us) override {
    charged_us += work_us;
    return true;
  }
  std::size_t poses = 0, pose_bytes = 0;
  double charged_us = 0;

 private:
  const CoefficientLayout layout_;
  const std::uint8_t half_spacing_;
  Stream stream_{"large", 1, Stream::Settings{}};
  std::optional<ChainState> state_;
  int number_ = 0;
  TimeUs now_ = 1'000'000;
};

TEST_F(StreamPosesTest, PosesAreLeftOutWhereNoViewerPays) {
  begin();
  const Profile profile = profile_from_query("k=15&scheme=catmull-rom").value();
  FakeReceiver poor, rich, other;
  poor.budget_us = 50;
  ASSERT_TRUE(stream_.watch(poor, profile));
  if (const FramePtr join = stream_.join_for(poor)) poor.decode(*join);
  play(3);
  poor.frames.clear();
  const std::uint64_t failed = stream_.poses_failed();
  play(20);
  wait(3 * kInterval);
  const auto keys_of = [](const FakeReceiver& receiver) {
    return std::count_if(receiver.frames.begin(), receiver.frames.end(),
                         [](const auto& f) { return f->envelope.is_key(); });
  };
  EXPECT_GE(keys_of(poor), 19) << "keys always come";
  EXPECT_GT(stream_.poses_failed(), failed + 200);
  EXPECT_LT(poor.charged_us, 60) << "one beyond the budget, at most";
  EXPECT_EQ(poor.undecodable, 0);

  ASSERT_TRUE(stream_.watch(rich, profile));
  const double charged_us = poor.charged_us;
  poor.frames.clear();
  play(20);
  EXPECT_EQ(poor.charged_us, charged_us);
  EXPECT_GT(rich.charged_us, 0);
  EXPECT_GT(poor.frames.size(), 250u) << "another viewer pays";
  ASSERT_TRUE(stream_.watch(other, profile_from_query("k=14&scheme=catmull-rom").value()));
  stream_.unwatch(rich);
  poor.frames.clear();
  play(20);
  EXPECT_LT(poor.frames.size(), 45u) << "not one of another profile";
  EXPECT_GT(other.frames.size(), 250u);
  stream_.unwatch(poor);
  stream_.unwatch(other);
}

TEST_F(StreamPosesTest, KeysOfProfilesAreLeftOutWhereNoViewerPays) {
  begin();
  struct Payer : FakeReceiver {
    bool take_key(double work_us) override {
      keys_us += work_us;
      return pays;
    }
    double keys_us = 0;
    bool pays = true;
  } raw, poor, rich;
  poor.pays = raw.pays = false;
  for (Payer* each : {&raw, &poor}) ASSERT_TRUE(stream_.watch(*each, each == &raw ? kRaw : kLinear));
  play(10);
  EXPECT_GE(raw.frames.size(), 10u);
  EXPECT_EQ(raw.keys_us, 0);
  EXPECT_TRUE(poor.frames.empty());
  EXPECT_GT(poor.keys_us, 10 * 4);
  poor.pays = true;
  wait(3 * kInterval);
  ASSERT_FALSE(poor.frames.empty()) << "paid later, while the sender rests";
  EXPECT_EQ(poor.frames.back()->envelope.sequence, 9u);
  poor.pays = false;
  ASSERT_TRUE(stream_.watch(rich, kLinear));
  play(10);
  EXPECT_GE(poor.frames.size(), 10u) << "another viewer pays";
  for (Payer* each : {&raw, &poor, &rich}) stream_.unwatch(*each);
}

TEST_F(StreamPosesTest, ViewersWhoCannotPayTakeNoPosesFromOthers) {
  begin();
  const Profile profile = kCurved;
  std::vector<FakeReceiver> poor(40);
  for (FakeReceiver& each : poor) {
    each.budget_us = 0;
    each.shared = &poor;
    ASSERT_TRUE(stream_.watch(each, profile));
  }
  FakeReceiver rich;
  ASSERT_TRUE(stream_.watch(rich, profile));
  play(3);
  rich.frames.clear();
  for (std::size_t i = 0; i < 30; ++i) {
    stream_.unwatch(poor[i]);
    play(1);
    ASSERT_TRUE(stream_.watch(poor[i], profile));
  }
  EXPECT_GE(rich.frames.size(), 30u * 3);
}

TEST_F(StreamPosesTest, PosesCostWhatTheyTakeWhateverTheirKeysCost) {
  const Profile curved = profile_from_query("k=15&scheme=catmull-rom").value();
  LargeStream still(4096, 8, 8), even(4096, 8, 8), moving(4096, 8, 8);
  for (LargeStream* stream : {&still, &even, &moving}) stream->watch(curved);
  EXPECT_LT(still.play(6, [](int, int) { return 0; }), 20u);
  EXPECT_GT(still.poses, 40u);
  EXPECT_EQ(still.charged_us, 0) << "there is nothing to work out";
  even.play(6, [](int i, int j) { return i * 20 * (j % 5); });
  EXPECT_LT(even.pose_bytes, 10 * even.poses);
  EXPECT_GT(even.charged_us, 170 * static_cast<double>(even.poses)) << "found out, for all but one of 15";
  moving.play(6, [](int i, int j) { return i * i * (j * 7919 % 8000 - 4000); });
  EXPECT_GT(moving.pose_bytes, 10'000 * moving.poses);
  EXPECT_GT(moving.charged_us, 170 * static_cast<double>(moving.poses) + static_cast<double>(moving.pose_bytes) / 40);
}

TEST_F(StreamPosesTest, OneViewerMayWatchAHundredStreams) {
  const auto smooth = [](int i, int j) { return 25'000. / (20 + j) * std::sin(i * 0.15 + j); };
  LargeStream linear(300, 3, 3), curved(300, 3, 3);
  linear.watch(kLinear);
  curved.watch(kCurved);
  EXPECT_GT(curved.play(30, smooth), 180u) << "as of a typical surface";
  curved.charged_us = 0;
  curved.play(30, smooth);
  EXPECT_GT(curved.charged_us, 0);
  EXPECT_LT(100 * curved.charged_us, 125'000) << "half of per_address.work_us_per_s";
  linear.play(30, smooth);
  EXPECT_EQ(linear.charged_us, 0);
}

TEST_F(StreamPosesTest, LinearPosesTakeAFewBytesMoreThanRaw) {
  FakeReceiver raw, linear;
  ASSERT_TRUE(stream_.watch(raw, kRaw));
  ASSERT_TRUE(stream_.watch(linear, kLinear));
  begin();
  play(11);
  wait(3 * kInterval);
  EXPECT_EQ(raw.frames.size(), 11u);
  EXPECT_EQ(linear.frames.size(), 1u + 3 * 10) << "a key shows the first of its poses";
  const auto bytes_of = [](const FakeReceiver& receiver) {
    std::size_t bytes = 0;
    for (const auto& frame : receiver.frames) bytes += frame->message().size();
    return bytes;
  };
  EXPECT_EQ(bytes_of(linear), bytes_of(raw) + 10 * (1 + 2 * 5)) << "the step of each key, and two steps alone";
}

TEST_F(StreamPosesTest, OvertakenPosesAreSkippedKeysAreNot) {
  FakeReceiver linear;
  FakeReceiver curved;
  ASSERT_TRUE(stream_.watch(linear, kLinear));
  ASSERT_TRUE(stream_.watch(curved, kCurved));
  begin();
  play(6);
  for (int round = 0; round < 5; ++round) {  // Key intervals without pumping.
    ASSERT_TRUE(stream_.add_frame(sender_.next(now_), now_));
    linear.frames.clear();
    curved.frames.clear();
    now_ += kInterval - 1000;
    stream_.pump(now_);
    for (FakeReceiver* receiver : {&linear, &curved}) {
      const auto shown = std::count_if(receiver->frames.begin(), receiver->frames.end(),
                                       [](const FramePtr& frame) { return frame->envelope.step.of != 0; });
      EXPECT_LE(shown, 1) << round;
    }
    now_ += 1000;
  }
  wait(3 * kInterval);
  EXPECT_EQ(linear.undecodable + curved.undecodable, 0) << "no key is missing";
  EXPECT_EQ(linear.poses.back().key, key_number(10));
  EXPECT_EQ(curved.poses.back().key, key_number(10));
}

TEST_F(StreamPosesTest, JitteredKeysKeepChainWhole) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kLinear));
  begin();
  const int jitter_ms[] = {0, 14, 3, 20, 0, 0, 25, 1, 9, 17, 2, 28};
  const TimeUs start = now_;
  for (int i = 0; i < 60; ++i) {
    const TimeUs capture = start + i * kInterval;
    wait(capture + jitter_ms[i % 12] * 1000 - now_);
    ASSERT_TRUE(stream_.add_frame(sender_.next(capture), now_));
  }
  wait(5 * kInterval);
  EXPECT_EQ(receiver.undecodable, 0);
  EXPECT_EQ(receiver.poses.back().key, key_number(59));
  EXPECT_GE(receiver.poses.size(), 150u);
}

TEST_F(StreamPosesTest, PosesAreEncodedOncePerProfile) {
  FakeReceiver a;
  FakeReceiver b;
  ASSERT_TRUE(stream_.watch(a, kLinear));
  ASSERT_TRUE(stream_.watch(b, Profile{Profile::Rate::kInterpolated, 3, 2}));
  begin();
  play(4);
  EXPECT_EQ(stream_.profile_count(), 1u) << "all bands and two of two bands are one profile";
  EXPECT_EQ(a.frames, b.frames);
  EXPECT_EQ(a.frames.size(), stream_.frames_made());
}

TEST_F(StreamPosesTest, BandsAreCut) {
  FakeReceiver receiver;
  for (const Profile::Rate rate : {Profile::Rate::kRaw, Profile::Rate::kInterpolated}) {
    ASSERT_TRUE(stream_.watch(receiver, Profile{rate, 3, 1}));
    if (rate == Profile::Rate::kRaw) begin();
    if (rate != Profile::Rate::kRaw) receiver.decode(*stream_.join_for(receiver));
    receiver.poses.clear();
    play(4);
    EXPECT_EQ(receiver.undecodable, 0);
    ASSERT_GT(receiver.poses.size(), 3u);
    for (const auto& pose : receiver.poses) {
      EXPECT_EQ(pose.key.bands, 1);
      if (pose.envelope.step.at != pose.envelope.step.of) continue;
      Key low = key_number(static_cast<int>(pose.envelope.sequence));
      low.bands = 1;
      std::fill(low.q.begin() + 12, low.q.end(), 0);
      EXPECT_EQ(pose.key, low);
    }
  }
}

TEST_F(StreamPosesTest, RestoredBandsTakeOneJoin) {
  for (const Profile& profile : {kRaw, kLinear, kCurved}) {
    Stream stream("a", 7, Stream::Settings{});
    FakeSender sender;
    FakeReceiver receiver;
    ASSERT_TRUE(stream.claim(sender));
    TimeUs now = 0;
    const auto play_on = [&](Profile by, std::uint8_t bands) {
      by.bands = bands;
      ASSERT_TRUE(stream.watch(receiver, by));
      if (const auto join = stream.join_for(receiver)) receiver.decode(*join);
      receiver.frames.clear();
      receiver.poses.clear();
      for (const TimeUs end = now + 6 * kInterval; now < end; now += 1000) {
        if (now % kInterval == 0) {
          EXPECT_TRUE(stream.add_frame(sender.next(now), now));
        }
        stream.pump(now);
      }
      EXPECT_EQ(receiver.undecodable, 0);
      ASSERT_GT(receiver.poses.size(), 3u);
      for (const auto& frame : receiver.frames) EXPECT_NE(frame->envelope.kind, FrameKind::kJoin) << "one was enough";
      for (const auto& pose : receiver.poses) EXPECT_EQ(pose.key.bands, (1u << bands) - 1);
    };
    ASSERT_TRUE(stream.announce(small_announce(), 1));
    ASSERT_TRUE(stream.add_frame(sender.next(now), now));
    now = kInterval;
    const std::size_t before = receiver.infos.size();
    for (const std::uint8_t bands : {2, 1, 2, 1, 2}) play_on(profile, bands);
    for (std::size_t i = before; i < receiver.infos.size(); ++i) EXPECT_EQ(receiver.infos[i].epoch, 1u);
  }
}

TEST_F(StreamPosesTest, JoinSynchronisesReceiverAtAnyMoment) {
  for (const Profile& profile : {kRaw, kLinear, kCurved}) {
    Stream stream("a", 7, Stream::Settings{});
    FakeSender sender;
    FakeReceiver steady;
    ASSERT_TRUE(stream.watch(steady, profile));
    ASSERT_TRUE(stream.claim(sender));
    ASSERT_TRUE(stream.announce(small_announce(), 1));
    std::vector<std::unique_ptr<FakeReceiver>> late;
    TimeUs now = 0;
    for (; now < 12 * kInterval; now += 1000) {
      if (now % kInterval == 0) {
        ASSERT_TRUE(stream.add_frame(sender.next(now), now));
      }
      stream.pump(now);
      if (now < 2 * kInterval || now > 6 * kInterval) continue;
      late.push_back(std::make_unique<FakeReceiver>());
      ASSERT_TRUE(stream.watch(*late.back(), profile));
      const FramePtr join = stream.join_for(*late.back());
      ASSERT_TRUE(join);
      EXPECT_EQ(join, stream.join_for(steady)) << "made once";
      late.back()->decode(*join);
    }
    for (const auto& receiver : late) {
      EXPECT_EQ(receiver->undecodable, 0);
      EXPECT_EQ(receiver->poses.back().key, steady.poses.back().key);
    }
  }
}

TEST_F(StreamPosesTest, ProfileCanChangeAnyTime) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kRaw));
  begin();
  play(3);
  for (const Profile& profile : {kLinear, kCurved, kRaw, kCurved, kLinear}) {
    ASSERT_TRUE(stream_.watch(receiver, profile));
    EXPECT_EQ(receiver.infos.back().profile.rate, profile.rate);
    EXPECT_EQ(receiver.infos.back().profile.scheme, profile.scheme);
    receiver.decode(*stream_.join_for(receiver));
    const std::size_t before = receiver.poses.size();
    play(4);
    EXPECT_EQ(receiver.undecodable, 0);
    EXPECT_GE(receiver.poses.size() - before, profile == kRaw ? 4u : profile == kCurved ? 6u : 9u);
    EXPECT_EQ(stream_.profile_count(), 1u);
  }
}

TEST_F(StreamPosesTest, SenderJoinBridgesGap) {
  FakeReceiver raw;
  FakeReceiver linear;
  FakeReceiver curved;
  ASSERT_TRUE(stream_.watch(raw, kRaw));
  ASSERT_TRUE(stream_.watch(linear, kLinear));
  ASSERT_TRUE(stream_.watch(curved, kCurved));
  begin();
  play(3);
  sender_.skip_number();
  sender_.begin_anew();
  play(3);
  wait(3 * kInterval);
  EXPECT_EQ(raw.undecodable + linear.undecodable + curved.undecodable, 0);
  EXPECT_EQ(raw.poses.size(), 6u);
  EXPECT_EQ(linear.poses.back().key, key_number(6));
  EXPECT_EQ(curved.poses.back().key, key_number(6));
}

TEST_F(StreamPosesTest, LateRawViewerHasNothingDue) {
  begin();
  play(3);
  FakeReceiver late;
  ASSERT_TRUE(stream_.watch(late, kRaw));
  EXPECT_FALSE(stream_.next_due_us());
  play(2);
  EXPECT_FALSE(stream_.next_due_us());
  EXPECT_FALSE(late.frames.empty());
}

}  // namespace
}  // namespace eigencast::broker
