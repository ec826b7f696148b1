// SPDX-License-Identifier: MIT
//
// What becomes of a stream: senders come and go, watchers and frames are checked, traces pass through.
#include "broker/relay/stream.h"

#include <gmock/gmock.h>

#include <ctime>
#include <list>

#include "broker/websocket/protocol.h"
#include "tests/unit/broker/relay/stream_scene.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using State = control::StreamInfo::State;

TEST_F(StreamTest, StalledStreamHoldsLastPose) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kRaw));
  EXPECT_EQ(receiver.infos.back().state, State::kWaiting);
  EXPECT_EQ(receiver.infos.back().epoch, 0u);
  EXPECT_EQ(receiver.infos.back().stream_id, 7u);
  EXPECT_FALSE(stream_.join_for(receiver));
  begin();
  EXPECT_EQ(receiver.infos.back().state, State::kLive);
  EXPECT_EQ(receiver.infos.back().asset, small_announce().asset);
  play(3);
  stream_.release(sender_);
  EXPECT_EQ(receiver.infos.back().state, State::kStalled);
  FakeReceiver late;
  ASSERT_TRUE(stream_.watch(late, kLinear));
  EXPECT_EQ(late.infos.back().state, State::kStalled);
  late.decode(*stream_.join_for(late));
  EXPECT_EQ(late.poses.back().key, key_number(2));
}

TEST_F(StreamTest, AnnouncementsAreWrittenOnceForAllViewersOfAProfile) {
  FakeReceiver first, second, other;
  begin();
  const auto text_of = [&](const FakeReceiver& receiver) {
    const auto text = stream_.info_text(receiver);
    EXPECT_EQ(text, stream_.info_text(receiver));
    EXPECT_EQ(*text, *websocket::framed(websocket::Opcode::kText, text_from_control(stream_.info_for(receiver))));
    return text;
  };
  for (FakeReceiver* receiver : {&first, &second}) ASSERT_TRUE(stream_.watch(*receiver, kRaw));
  ASSERT_TRUE(stream_.watch(other, kLinear));
  const auto live = text_of(first);
  EXPECT_EQ(text_of(second), live);
  EXPECT_NE(text_of(other), live);
  ASSERT_TRUE(stream_.watch(second, kLinear));
  EXPECT_EQ(text_of(second), text_of(other)) << "it changed its profile";
  stream_.release(sender_);
  EXPECT_NE(*text_of(first), *live) << "stalled";
  begin();
  EXPECT_NE(*text_of(first), *live) << "another epoch";
}

TEST_F(StreamTest, AnnouncementsOfAllProfilesThatAreServedAreWrittenOnce) {
  control::Announce announce = small_announce();
  announce.format.rows = 8;
  announce.format.band_ends = {1, 2, 3, 4, 5, 6, 7, 8};
  ASSERT_TRUE(stream_.claim(sender_));
  ASSERT_TRUE(stream_.announce(announce, 1));
  std::vector<std::unique_ptr<FakeReceiver>> crowd;
  for (std::uint8_t k = 2; k < 12; ++k) {
    for (std::uint8_t bands = 1; bands <= 8; ++bands) {
      Profile profile{Profile::Rate::kEstimated};
      profile.k = k;
      profile.scheme = default_scheme(profile.rate);
      profile.bands = bands;
      crowd.push_back(std::make_unique<FakeReceiver>());
      ASSERT_TRUE(stream_.watch(*crowd.back(), profile));
    }
  }
  const auto texts = [&] {
    std::vector<std::shared_ptr<const std::string>> all;
    for (const auto& receiver : crowd) all.push_back(stream_.info_text(*receiver));
    return all;
  };
  const auto first = texts();
  EXPECT_GT(std::set(first.begin(), first.end()).size(), 64u);
  EXPECT_EQ(texts(), first);
}

TEST_F(StreamTest, TheSenderIsChargedForEachProfileThatIsTold) {
  begin();
  FakeReceiver first, second, other;
  ASSERT_TRUE(stream_.watch(first, kRaw));
  const double alone_us = stream_.telling_us();
  ASSERT_TRUE(stream_.watch(second, kRaw));
  const double same_us = stream_.telling_us() - alone_us;
  ASSERT_TRUE(stream_.watch(other, kLinear));
  EXPECT_GT(stream_.telling_us() - alone_us - same_us, same_us);
}

TEST_F(StreamTest, KeysInProfilesAreWorkOfTheirSendersTurn) {
  begin();
  FakeReceiver linear, estimated;
  ASSERT_TRUE(stream_.watch(linear, kLinear));
  play(1);
  const double one_us = stream_.take_profiles_us();
  EXPECT_GT(one_us, 0);
  EXPECT_EQ(stream_.take_profiles_us(), 0);
  ASSERT_TRUE(stream_.watch(estimated, Profile{Profile::Rate::kEstimated}));
  play(1);
  EXPECT_GT(stream_.take_profiles_us(), 1.9 * one_us);
}

TEST_F(StreamTest, EstimatesOfWorkFollowCoefficientsAndBytes) {
  ASSERT_TRUE(stream_.claim(sender_));
  control::Announce large = small_announce();
  large.format = {};
  large.format.rows = 4096;
  large.format.channels = 8;
  large.format.band_ends = {4096};
  ASSERT_TRUE(stream_.announce(large, ++epoch_));
  EXPECT_GT(stream_.decoding_us(36, true), 270) << "coefficients that change by a byte in all";
  EXPECT_LT(stream_.decoding_us(36, false), 10) << "they count once for a message in fragments";
  EXPECT_GT(stream_.decoding_us(8000, false), 900);
  large.format.codec = "float32";
  ASSERT_TRUE(stream_.announce(large, ++epoch_));
  EXPECT_LT(stream_.decoding_us(131'099, true), 300) << "copied, not decoded";
  large.format.rows = 300;
  large.format.channels = 3;
  large.format.band_ends = {300};
  large.format.codec = "quantised";
  ASSERT_TRUE(stream_.announce(large, ++epoch_));
  EXPECT_LT(100 * 30 * stream_.decoding_us(300, true), 200'000) << "100 streams of 30 keys a second";
}

TEST_F(StreamTest, ProfilesOfViewersCostTheSenderNothing) {
  begin();
  const double alone_us = stream_.decoding_us(36, true);
  std::list<FakeReceiver> receivers;
  for (int k = 2; k <= 15; ++k) {
    for (const Profile::Rate rate : {Profile::Rate::kInterpolated, Profile::Rate::kEstimated}) {
      for (const std::uint8_t bands : {1, 2}) {
        const auto scheme = default_scheme(rate);
        const Profile profile{rate, static_cast<std::uint8_t>(k), bands, scheme};
        ASSERT_TRUE(stream_.watch(receivers.emplace_back(), profile));
      }
    }
  }
  ASSERT_GT(stream_.profile_count(), 50u);
  EXPECT_EQ(stream_.decoding_us(36, true), alone_us);
}

TEST_F(StreamTest, OnlyEncodingAJoinIsWork) {
  FakeReceiver first, second;
  begin();
  play(1);
  ASSERT_TRUE(stream_.watch(first, kRaw));
  ASSERT_TRUE(stream_.watch(second, kRaw));
  double work_us = 0;
  EXPECT_TRUE(stream_.join_for(first, &work_us));
  const double once_us = std::exchange(work_us, 0);
  EXPECT_GT(once_us, 0);
  EXPECT_TRUE(stream_.join_for(second, &work_us));
  EXPECT_EQ(work_us, 0) << "made before";
  ASSERT_TRUE(stream_.watch(second, kLinear));
  EXPECT_TRUE(stream_.join_for(second, &work_us));
  EXPECT_EQ(work_us, once_us) << "another profile";
}

TEST_F(StreamTest, ReturningSenderBeginsNewEpoch) {
  FakeReceiver linear;
  FakeReceiver curved;
  ASSERT_TRUE(stream_.watch(linear, kLinear));
  ASSERT_TRUE(stream_.watch(curved, kCurved));
  begin();
  play(3);
  stream_.release(sender_);
  FakeSender second;
  ASSERT_TRUE(stream_.claim(second));
  ASSERT_TRUE(stream_.announce(small_announce(), 20));
  EXPECT_EQ(linear.infos.back().epoch, 20u);
  linear.poses.clear();
  curved.poses.clear();
  second.tag = 2;
  sender_ = second;
  play(3);
  wait(3 * kInterval);
  EXPECT_EQ(linear.undecodable + curved.undecodable, 0);
  EXPECT_EQ(linear.poses.size(), 7u);
  EXPECT_EQ(curved.poses.size(), 7u);
  for (const auto& pose : linear.poses) EXPECT_EQ(pose.envelope.epoch, 20u);
}

TEST_F(StreamTest, OneSenderAtATime) {
  begin();
  FakeSender second;
  const auto refused = stream_.claim(second);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kRefused);
  stream_.release(second);
  EXPECT_TRUE(stream_.has_publisher()) << "only the publisher releases";
  stream_.release(sender_);
  EXPECT_TRUE(stream_.claim(second));
}

TEST_F(StreamTest, MalformedFramesChangeNothing) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, kRaw));
  EXPECT_FALSE(stream_.add_frame(sender_.next(0), 0)) << "not announced";
  sender_ = FakeSender();
  begin();
  play(2);
  const Bytes good = sender_.next(now_);
  for (std::size_t cut = 0; cut < good.size(); ++cut) {
    EXPECT_FALSE(stream_.add_frame(ByteView(good).first(cut), now_)) << cut;
  }
  const auto changed = [&](std::size_t at, std::uint8_t value) {
    Bytes bad = good;
    bad[at] = value;
    return bad;
  };
  EXPECT_FALSE(stream_.add_frame(changed(0, 3), now_)) << "step";
  EXPECT_FALSE(stream_.add_frame(changed(0, 4), now_)) << "estimate";
  EXPECT_FALSE(stream_.add_frame(changed(0, 1 | 8), now_)) << "ahead";
  EXPECT_FALSE(stream_.add_frame(changed(0, 1 | 16), now_)) << "reserved flag";
  EXPECT_FALSE(stream_.add_frame(changed(2, 2), now_)) << "another tag";
  EXPECT_FALSE(stream_.add_frame(changed(3, 9), now_)) << "gap";
  EXPECT_FALSE(stream_.add_frame(changed(3, 1), now_)) << "sequence again";
  EXPECT_FALSE(stream_.add_frame(changed(4, 2), now_)) << "band 0 missing";
  EXPECT_FALSE(stream_.add_frame(changed(4, 7), now_)) << "band not announced";
  FakeSender backward = sender_;
  backward.begin_anew();
  EXPECT_FALSE(stream_.add_frame(backward.next(now_ - kInterval), now_)) << "capture time goes back";
  EXPECT_EQ(receiver.frames.size(), 2u);
  EXPECT_TRUE(stream_.add_frame(good, now_));
  EXPECT_EQ(receiver.poses.back().key, key_number(2));
}

TEST_F(StreamTest, KeyCannotBeginChain) {
  begin();
  (void)sender_.next(now_);
  const auto added = stream_.add_frame(sender_.next(now_ + 1), now_);
  ASSERT_FALSE(added);
  EXPECT_EQ(added.error().code, ErrorCode::kCorrupt);
}

TEST_F(StreamTest, WatchersAreCapped) {
  Stream stream("a", 1, {500'000, 2});
  ASSERT_TRUE(stream.claim(sender_));
  ASSERT_TRUE(stream.announce(small_announce(), 1));
  FakeReceiver a;
  FakeReceiver b;
  FakeReceiver c;
  ASSERT_TRUE(stream.watch(a, kRaw));
  ASSERT_TRUE(stream.watch(b, kRaw));
  EXPECT_EQ(stream.watch(c, kRaw).error().code, ErrorCode::kTooLarge);
  stream.unwatch(a);
  EXPECT_TRUE(stream.watch(c, kRaw));
  EXPECT_EQ(sender_.counts, (std::vector<std::uint32_t>{0, 1, 2, 1, 2}));
}

TEST_F(StreamTest, OneHolderLeavesPlacesToOthers) {
  struct Held : FakeReceiver {
    std::string holder() const override { return who; }
    std::string who;
  };
  Stream stream("a", 1, {.max_watchers = 60});
  std::vector<std::unique_ptr<Held>> watchers;
  const auto crowd = [&](const std::string& who) {
    for (std::size_t count = 0;; ++count) {
      watchers.push_back(std::make_unique<Held>());
      watchers.back()->who = who;
      if (const auto placed = stream.watch(*watchers.back(), kRaw); !placed) {
        EXPECT_EQ(placed.error().code, ErrorCode::kTooLarge);
        watchers.pop_back();
        return count;
      }
      EXPECT_TRUE(stream.watch(*watchers.back(), kLinear)) << "another profile, the same place";
    }
  };
  EXPECT_EQ(crowd("address 1.1.1.1"), 12u) << "a quarter of the other 48";
  EXPECT_EQ(crowd("address 2.2.2.2"), 9u);
  EXPECT_EQ(crowd(""), 36u) << "who is spared leaves three";
  EXPECT_EQ(crowd("a newcomer"), 1u);
  EXPECT_EQ(stream.watchers(), 58u);
  for (int i = 0; i < 12; ++i) stream.unwatch(*watchers[static_cast<std::size_t>(i)]);
  EXPECT_EQ(stream.watchers(), 46u);
  EXPECT_EQ(crowd("a newcomer"), 2u);
}

TEST_F(StreamTest, WishesForTheSameFramesShareAProfile) {
  begin();
  std::vector<FakeReceiver> receivers(4);
  ASSERT_TRUE(stream_.watch(receivers[0], kRaw));
  ASSERT_TRUE(stream_.watch(receivers[1], Profile{Profile::Rate::kRaw, 7})) << "raw has no k";
  ASSERT_TRUE(stream_.watch(receivers[2], kLinear));
  ASSERT_TRUE(stream_.watch(receivers[3], Profile{.bands = 2})) << "the stream has two bands";
  EXPECT_EQ(stream_.profile_count(), 2u);
}

TEST_F(StreamTest, TracesFollowTheShortestInterval) {
  FakeReceiver a, b, c;
  begin();
  for (FakeReceiver* receiver : {&a, &b, &c}) ASSERT_TRUE(stream_.watch(*receiver, kRaw));
  stream_.trace(a, 9);
  stream_.trace(b, 4);
  stream_.trace(c, 4);
  EXPECT_EQ(stream_.trace_every(), 4u);
  stream_.trace(b, 12);
  stream_.trace(b, 12);
  EXPECT_EQ(stream_.trace_every(), 4u) << "c still wants them";
  stream_.unwatch(c);
  EXPECT_EQ(stream_.trace_every(), 9u);
  stream_.trace(a, 0);
  stream_.trace(a, 0);
  EXPECT_EQ(stream_.trace_every(), 12u);
  stream_.unwatch(b);
  EXPECT_EQ(stream_.trace_every(), 0u);
}

TEST(TracerTest, OnlyThoseWhoAskedAreVisited) {
  Tracer tracer;
  FakeReceiver often, seldom, never;
  tracer.want(often, 5);
  tracer.want(seldom, 10);
  tracer.want(never, 5);
  tracer.want(never, 0);
  EXPECT_EQ(tracer.who_wants(15), std::vector<Watcher*>{&often});
  EXPECT_EQ(tracer.who_wants(20).size(), 2U);
  EXPECT_TRUE(tracer.who_wants(16).empty());
}

TEST(TracerTest, RequestsVisitNoOtherWatchers) {
  const auto processor_time_beside = [](std::size_t count) {
    Tracer tracer;
    std::vector<FakeReceiver> watchers(count);
    for (FakeReceiver& watcher : watchers) tracer.want(watcher, 1000);
    const std::clock_t before = std::clock();
    for (std::uint32_t i = 0; i < 40'000; ++i) tracer.want(watchers[i % count], 1000 - i % 3);
    const std::clock_t used = std::clock() - before;
    EXPECT_EQ(tracer.every(), 998u);
    for (FakeReceiver& watcher : watchers) tracer.want(watcher, 0);
    EXPECT_EQ(tracer.every(), 0u);
    return used;
  };
  // Visiting all takes thousands of times as much, however busy the machine is.
  EXPECT_LT(processor_time_beside(40'000), 300 * (processor_time_beside(10) + 1'000));
}

control::Trace trace_from(const std::string& text) {
  return std::get<control::Trace>(control_from_text(text).value());
}

TEST_F(StreamTest, TracesReachRequestersWithBrokerStreamId) {
  FakeReceiver requests, asks_seldom, does_not;
  for (FakeReceiver* receiver : {&requests, &asks_seldom, &does_not}) ASSERT_TRUE(stream_.watch(*receiver, kRaw));
  stream_.trace(requests, 5);
  stream_.trace(asks_seldom, 10);
  control::Trace sent;
  sent.stream_id = 99;
  sent.sequence = 5;
  sent.stages = {{"started", 12}};
  stream_.relay_trace(sent);
  ASSERT_EQ(requests.traces.size(), 1u);
  EXPECT_EQ(trace_from(requests.traces[0]).stream_id, 7u);
  EXPECT_EQ(trace_from(requests.traces[0]).sequence, 5u);
  EXPECT_TRUE(does_not.traces.empty());
  EXPECT_TRUE(asks_seldom.traces.empty());
}

TEST_F(StreamTest, TracesArePaidByHowManyAreTold) {
  std::vector<FakeReceiver> receivers(40);
  for (FakeReceiver& receiver : receivers) ASSERT_TRUE(stream_.watch(receiver, kRaw));
  for (std::size_t i = 0; i < 30; ++i) stream_.trace(receivers[i], 5);
  control::Trace sent;
  sent.sequence = 6;
  stream_.relay_trace(sent);
  EXPECT_EQ(stream_.take_unpaid_us(), 0);
  sent.sequence = 5;
  for (int i = 0; i < 3; ++i) stream_.relay_trace(sent);
  EXPECT_DOUBLE_EQ(stream_.take_unpaid_us(), 3 * 30 * 2.0) << "2 us each";
  EXPECT_EQ(receivers[29].traces.size(), 3U);
  EXPECT_TRUE(receivers[30].traces.empty());
}

TEST_F(StreamTest, KeysArePaidByHowManyWatch) {
  std::vector<FakeReceiver> receivers(1'000);
  for (FakeReceiver& receiver : receivers) ASSERT_TRUE(stream_.watch(receiver, kRaw));
  begin();
  play(3);
  EXPECT_GE(stream_.take_unpaid_us(), 3 * 30.0) << "whether they leave or not";
}

TEST_F(StreamTest, CrowdsThatAskForTracesCostTheSenderLittle) {
  std::vector<FakeReceiver> crowd;
  for (int i = 0; i < 300; ++i) crowd.emplace_back("address " + std::to_string(i % 3));
  FakeReceiver other("another");
  for (FakeReceiver& receiver : crowd) {
    ASSERT_TRUE(stream_.watch(receiver, kRaw));
    (void)stream_.trace(receiver, 1);
  }
  ASSERT_TRUE(stream_.watch(other, kRaw));
  (void)stream_.trace(other, 1);
  control::Trace sent;
  sent.sequence = 5;
  stream_.relay_trace(sent);
  EXPECT_LE(stream_.take_unpaid_us(), 64 * 2.0);
  EXPECT_EQ(other.traces.size(), 1U);
  for (FakeReceiver& receiver : crowd) stream_.unwatch(receiver);
  FakeReceiver late("address 0");
  ASSERT_TRUE(stream_.watch(late, kRaw));
  (void)stream_.trace(late, 1);
  stream_.relay_trace(sent);
  EXPECT_EQ(late.traces.size(), 1U) << "who leaves makes room";
  stream_.unwatch(late);
  stream_.unwatch(other);
}

TEST_F(StreamTest, TraceIntervalIsTheSmallestRequested) {
  FakeReceiver a, b, stranger;
  ASSERT_TRUE(stream_.watch(a, kRaw));
  ASSERT_TRUE(stream_.watch(b, kLinear));
  stream_.trace(stranger, 1);
  EXPECT_EQ(stream_.trace_every(), 0u);
  stream_.trace(a, 30);
  stream_.trace(b, 10);
  EXPECT_EQ(stream_.trace_every(), 10u);
  stream_.unwatch(b);
  EXPECT_EQ(stream_.trace_every(), 30u);
  stream_.trace(a, 0);
  EXPECT_EQ(stream_.trace_every(), 0u);
}

TEST_F(StreamTest, BrokerStagesAreReportedAfterWrite) {
  FakeReceiver receiver;
  begin();
  ASSERT_TRUE(stream_.watch(receiver, kLinear));
  stream_.trace(receiver, 2);
  for (int i = 0; i < 6; ++i) {
    ASSERT_TRUE(stream_.add_frame(sender_.next(now_), now_));
    for (int ms = 0; ms < 30; ++ms, now_ += 1000) {
      stream_.pump(now_);
      for (const FramePtr& frame : receiver.frames)
        if (frame->times.written_us == 0) frame->times.written_us = now_ + 40;
    }
  }
  ASSERT_GE(receiver.traces.size(), 4u);
  int held = 0;
  for (const auto& text : receiver.traces) {
    const control::Trace trace = trace_from(text);
    EXPECT_EQ(trace.sequence % 2, 0u);
    ASSERT_GE(trace.stages.size(), 2u);
    EXPECT_EQ(trace.stages.front().first, control::stage::kArrived);
    EXPECT_EQ(trace.stages.back().first, control::stage::kWritten);
    EXPECT_EQ(trace.stages.front().second, 1'000'000 + static_cast<TimeUs>(trace.sequence) * kInterval);
    if (trace.stages.size() < 3) continue;
    ++held;
    EXPECT_EQ(trace.stages[1].first, control::stage::kScheduled);
    EXPECT_LE(trace.stages[1].second, trace.stages[2].second);
  }
  EXPECT_GT(held, 2);
}

}  // namespace
}  // namespace eigencast::broker
