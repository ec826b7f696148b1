// SPDX-License-Identifier: MIT
//
// What each rate mode and scheme delivers, pose by pose, on a fake clock.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "broker/relay/stream.h"
#include "common/motion/curve.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using testing::FakeReceiver;
using testing::FakeSender;
using testing::key_number;
using testing::kInterval;
using testing::small_announce;
using testing::small_layout;
using Scheme = Profile::Scheme;
using Form = Profile::Form;

constexpr TimeUs kStart = 1'000'000;

Profile interpolated(Scheme scheme, Form form = Form::kFull, std::uint8_t k = 3) {
  return {Profile::Rate::kInterpolated, k, form, 8, scheme};
}
Profile estimated(Scheme scheme, Form form = Form::kFull, std::uint8_t k = 3) {
  return {Profile::Rate::kEstimated, k, form, 8, scheme};
}

class RateModesTest : public ::testing::Test {
 protected:
  void begin(std::uint32_t velocity_channels = 0) {
    control::Announce announce = small_announce();
    announce.format.velocity_channels = velocity_channels;
    announce.format.velocity_us = 10'000;
    if (!stream_.has_publisher()) {
      ASSERT_TRUE(stream_.claim(sender_));
    }
    ASSERT_TRUE(stream_.announce(announce, ++epoch_));
    sender_.tag = stream_.tag();
  }

  /// Key i was made at kStart + i intervals and comes so much later; wakes every 500 us.
  void play(int count, const std::function<TimeUs(int)>& way_of) {
    for (int i = 0; i < count; ++i) {
      const TimeUs made_us = kStart + i * kInterval;
      wait_until(made_us + way_of(i));
      ASSERT_TRUE(stream_.add_frame(sender_.next(made_us), now_));
    }
    wait_until(now_ + 400'000);
  }
  void play(int count) {
    play(count, [](int) { return TimeUs{5000}; });
  }
  void wait_until(TimeUs end_us) {
    for (; now_ < end_us; now_ += 500) stream_.pump(now_);
  }

  static Key blended(int s, TimeUs t_us, bool with_after) {
    const auto at = [](int i) { return kStart + i * kInterval; };
    const CurveWeights w = catmull_rom_weights(s >= 2 ? std::optional(at(s - 2)) : std::nullopt, at(s - 1), at(s),
                                               with_after ? std::optional(at(s + 1)) : std::nullopt, t_us);
    const Key to = key_number(s), from = key_number(s - 1), before = key_number(std::max(0, s - 2)),
              after = key_number(s + 1);
    Key pose = to;
    for (std::size_t i = 0; i < pose.q.size(); ++i) {
      pose.q[i] = static_cast<std::int32_t>(
          std::llround(w.to * to.q[i] + w.from * from.q[i] + w.before * before.q[i] + w.after * after.q[i]));
    }
    return pose;
  }

  TimeUs now_ = kStart;
  std::uint32_t epoch_ = 0;
  FakeSender sender_;
  Stream stream_{"a", 7, Stream::Settings{}};
};

TEST_F(RateModesTest, CatmullRomUsesFourKeys) {
  FakeReceiver linear, curved;
  ASSERT_TRUE(stream_.watch(linear, interpolated(Scheme::kLinear)));
  ASSERT_TRUE(stream_.watch(curved, interpolated(Scheme::kCatmullRom)));
  begin();
  play(12);
  EXPECT_EQ(curved.undecodable, 0);
  ASSERT_EQ(curved.poses.size(), 1U + 3 * 11) << "as many as linear, exactly";
  EXPECT_EQ(linear.poses.size(), curved.poses.size());
  for (const auto& pose : curved.poses) {
    const int s = static_cast<int>(pose.envelope.sequence);
    if (pose.envelope.kind != FrameKind::kSynthetic) {
      EXPECT_EQ(pose.key, key_number(s));
      continue;
    }
    // The last interval never has its further key; all others have.
    const Key expected = blended(s, pose.envelope.capture_us, s < 11);
    for (std::size_t i = 0; i < expected.q.size(); ++i) EXPECT_NEAR(pose.key.q[i], expected.q[i], 1) << s << " " << i;
  }
}

TEST_F(RateModesTest, PreparedPosesEqualPosesMadeWhenDue) {
  std::mt19937 random(11);
  std::uniform_int_distribution<int> chance(0, 99);
  for (const Profile& profile : {interpolated(Scheme::kLinear), interpolated(Scheme::kHermite, Form::kFull, 5),
                                 interpolated(Scheme::kCatmullRom), interpolated(Scheme::kLinear, Form::kCompact)}) {
    control::Announce announce = small_announce();
    announce.format.velocity_channels = 1;
    announce.format.velocity_us = 10'000;
    std::array<Stream, 2> streams{Stream{"a", 7, Stream::Settings{}}, Stream{"a", 7, Stream::Settings{}}};
    std::array<FakeReceiver, 2> receivers;
    std::array<FakeSender, 2> senders;
    for (std::size_t i : {0u, 1u}) {
      ASSERT_TRUE(streams[i].claim(senders[i]));
      ASSERT_TRUE(streams[i].announce(announce, 1));
      ASSERT_TRUE(streams[i].watch(receivers[i], profile));
    }
    TimeUs now_us = kStart, captured_us = kStart;
    for (int key = 0; key < 300; ++key) {
      // Late keys, bursts, pauses, new chains.
      const int fate = chance(random);
      captured_us += fate < 4 ? 700'000 : kInterval;
      if (fate == 5) senders[0].begin_anew(), senders[1].begin_anew();
      const TimeUs arrives_us = std::max(now_us, captured_us + (fate > 90 ? 90'000 : fate * 100));
      for (; now_us < arrives_us; now_us += 500) {
        for (Stream& stream : streams) stream.pump(now_us);
      }
      for (std::size_t i : {0u, 1u}) {
        ASSERT_TRUE(streams[i].add_frame(senders[i].next(captured_us), now_us));
      }
      streams[1].prepare();
    }
    EXPECT_EQ(receivers[0].undecodable, 0);
    ASSERT_EQ(receivers[0].frames.size(), receivers[1].frames.size());
    for (std::size_t i = 0; i < receivers[0].frames.size(); ++i) {
      ASSERT_EQ(receivers[0].frames[i]->wire, receivers[1].frames[i]->wire) << i;
      ASSERT_EQ(receivers[0].frames[i]->times.due_us, receivers[1].frames[i]->times.due_us) << i;
    }
    for (std::size_t i : {0u, 1u}) streams[i].unwatch(receivers[i]);
  }
}

TEST(FeedTest, PosesArePreparedUntilOvertaken) {
  Feed feed(interpolated(Scheme::kLinear), Feed::Source{small_layout(), {}, 7, 1}, [](double) { return true; });
  std::vector<FramePtr> left;
  TimeUs now_us = kStart;
  std::shared_ptr<const ChainState> newest;
  const auto key_comes = [&](int s) {
    auto record = std::make_shared<KeyRecord>();
    record->sequence = static_cast<std::uint64_t>(s);
    record->capture_us = record->arrival_us = now_us = kStart + s * kInterval;
    record->bands = 3;
    record->before = newest;
    newest = std::make_shared<const ChainState>(
        ChainState{newest ? newest->newer : key_number(s), key_number(s), newest ? kInterval : 0});
    record->after = newest;
    feed.add_key(record, now_us, left);
    feed.prepare();
  };
  key_comes(0);
  EXPECT_EQ(feed.prepared_poses(), 0u) << "it begins the chain";
  key_comes(1);
  EXPECT_EQ(left.size(), 2u) << "key 0, and the first pose on the way from it, which was due at once";
  EXPECT_EQ(feed.prepared_poses(), 1u) << "the second";
  feed.prepare();
  EXPECT_EQ(feed.prepared_poses(), 1u) << "made once";
  feed.pump(now_us + kInterval / 3 - 1, left);
  EXPECT_EQ(left.size(), 2u) << "it leaves when it is due, not before";
  feed.pump(now_us + kInterval / 3, left);
  EXPECT_EQ(left.size(), 3u);
  EXPECT_EQ(feed.prepared_poses(), 0u);
  key_comes(2);  // Key 1 is due since 10 ms, so is a pose: pumping is behind.
  EXPECT_EQ(feed.prepared_poses(), 0u);
  feed.pump(now_us + kInterval / 3, left);
  feed.pump(now_us + kInterval * 2 / 3, left);
  ASSERT_EQ(left.back()->envelope.sequence, 2u);
  EXPECT_EQ(left.back()->envelope.kind, FrameKind::kKey) << "in its time";
  key_comes(3);
  EXPECT_EQ(feed.prepared_poses(), 1u);
}

TEST_F(RateModesTest, CatmullRomDoesNotWaitForLateKey) {
  std::mt19937 random(5);
  std::uniform_int_distribution<TimeUs> jitter(0, 12'000);
  class Timed : public FakeReceiver {
   public:
    explicit Timed(const TimeUs& now) : now_(now) {}
    void on_frame(const FramePtr& frame) override {
      FakeReceiver::on_frame(frame);
      written_us.push_back(now_);
    }
    std::vector<TimeUs> written_us;

   private:
    const TimeUs& now_;
  } receiver(now_);
  ASSERT_TRUE(stream_.watch(receiver, interpolated(Scheme::kCatmullRom)));
  begin();
  std::vector<TimeUs> ways;
  for (int i = 0; i < 60; ++i) ways.push_back(3000 + jitter(random));
  ways[50] = 80'000;
  play(60, [&](int i) { return ways[static_cast<std::size_t>(i)]; });
  EXPECT_EQ(receiver.undecodable, 0);
  int uneven = 0;
  for (std::size_t i = 60; i < 140; ++i) {
    if (std::abs(receiver.written_us[i] - receiver.written_us[i - 1] - kInterval / 3) > 1000) ++uneven;
  }
  EXPECT_LE(uneven, 4);
  // Hold: one interval for key s, one for key s+1, the least way and the jitter; never more.
  for (std::size_t i = 0; i < receiver.frames.size(); ++i) {
    const TimeUs age_us = receiver.written_us[i] - receiver.frames[i]->envelope.capture_us;
    EXPECT_LE(age_us, 3 * kInterval + 16'000);
  }
}

TEST_F(RateModesTest, HermiteCompactEqualsFull) {
  FakeReceiver linear, full, compact;
  ASSERT_TRUE(stream_.watch(linear, interpolated(Scheme::kLinear, Form::kFull, 5)));
  ASSERT_TRUE(stream_.watch(full, interpolated(Scheme::kHermite, Form::kFull, 5)));
  ASSERT_TRUE(stream_.watch(compact, interpolated(Scheme::kHermite, Form::kCompact, 5)));
  begin(1);
  play(10);
  EXPECT_EQ(full.undecodable + compact.undecodable, 0);
  ASSERT_EQ(full.poses.size(), 1U + 5 * 9);
  ASSERT_EQ(compact.poses.size(), full.poses.size());
  ASSERT_EQ(linear.poses.size(), full.poses.size());
  int bent = 0;
  for (std::size_t i = 0; i < full.poses.size(); ++i) {
    EXPECT_EQ(compact.poses[i].key, full.poses[i].key);
    EXPECT_EQ(compact.poses[i].envelope.capture_us, full.poses[i].envelope.capture_us);
    EXPECT_EQ(linear.poses[i].envelope.capture_us, full.poses[i].envelope.capture_us);
    if (full.poses[i].envelope.kind != FrameKind::kSynthetic) continue;
    const int s = static_cast<int>(full.poses[i].envelope.sequence);
    const auto [at, of] = full.poses[i].envelope.step;
    EXPECT_EQ(full.poses[i].key,
              hermite_keys(small_layout(), {1, 10'000}, key_number(s - 1), key_number(s), kInterval, at, of).value());
    if (full.poses[i].key != linear.poses[i].key) ++bent;
  }
  EXPECT_GT(bent, 30);
}

TEST_F(RateModesTest, HermiteWithoutVelocitiesFallsBackToLinear) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, interpolated(Scheme::kHermite)));
  begin(0);
  EXPECT_EQ(receiver.infos.back().profile.scheme, Scheme::kLinear);
  begin(1);
  EXPECT_EQ(receiver.infos.back().profile.scheme, Scheme::kHermite);
}

TEST_F(RateModesTest, EstimatesFollowEquation9) {
  for (const Scheme scheme : {Scheme::kLinear, Scheme::kDamped}) {
    FakeReceiver raw, full, compact;
    ASSERT_TRUE(stream_.watch(raw, {Profile::Rate::kRaw}));
    ASSERT_TRUE(stream_.watch(full, estimated(scheme)));
    ASSERT_TRUE(stream_.watch(compact, estimated(scheme, Form::kCompact)));
    sender_ = FakeSender();
    begin();
    now_ = kStart;
    play(10);
    EXPECT_EQ(full.undecodable + compact.undecodable, 0);
    ASSERT_EQ(compact.poses.size(), full.poses.size());
    // 10 keys, two estimates after each of the first eight that have a direction, and 200 ms = 20 thirds after the
    // last, of which the envelope numbers 15.
    ASSERT_EQ(full.poses.size(), 10U + 2 * 8 + 15);
    int keys = 0;
    for (std::size_t i = 0; i < full.poses.size(); ++i) {
      const Envelope& head = full.poses[i].envelope;
      EXPECT_EQ(compact.poses[i].key, full.poses[i].key) << i;
      EXPECT_EQ(compact.poses[i].envelope.capture_us, head.capture_us);
      const int s = static_cast<int>(head.sequence);
      if (head.kind != FrameKind::kEstimate) {
        EXPECT_EQ(full.poses[i].key, key_number(s));
        EXPECT_EQ(head.capture_us, kStart + keys++ * kInterval);
        continue;
      }
      EXPECT_EQ(head.capture_us, kStart + s * kInterval + head.step.at * kInterval / 3);
      EXPECT_EQ(compact.frames[i]->message().size(), 5U) << "no payload, no time";
      const Key expected = estimate_keys(small_layout(), key_number(s - 1), key_number(s), scheme == Scheme::kDamped,
                                         head.step.at, head.step.of)
                               .value();
      EXPECT_EQ(full.poses[i].key, expected);
    }
    EXPECT_EQ(keys, 10);
    // Nothing is held: keys leave as in raw mode.
    std::vector<std::uint64_t> sequences;
    for (const auto& pose : raw.poses) sequences.push_back(pose.envelope.sequence);
    EXPECT_EQ(sequences.size(), 10U);
    stream_.unwatch(raw);
    stream_.unwatch(full);
    stream_.unwatch(compact);
  }
}

TEST_F(RateModesTest, EstimatesNeverRunBackAfterLateKey) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, estimated(Scheme::kDamped, Form::kCompact)));
  begin();
  play(20, [](int i) { return TimeUs{i == 12 ? 70'000 : i == 13 ? 45'000 : 5000}; });
  EXPECT_EQ(receiver.undecodable, 0);
  TimeUs newest_us = 0;
  int stood_in = 0;
  for (const auto& pose : receiver.poses) {
    if (pose.envelope.kind != FrameKind::kEstimate) continue;
    EXPECT_GT(pose.envelope.capture_us, newest_us);
    newest_us = pose.envelope.capture_us;
    if (pose.envelope.sequence == 11 && pose.envelope.step.at > 3) ++stood_in;
  }
  EXPECT_GE(stood_in, 2) << "the estimates of key 11 stand in for key 12";
}

TEST_F(RateModesTest, BandsAreCutFromSyntheticPoses) {
  for (Profile profile : {estimated(Scheme::kDamped), interpolated(Scheme::kCatmullRom)}) {
    profile.bands = 1;
    FakeReceiver receiver;
    ASSERT_TRUE(stream_.watch(receiver, profile));
    sender_ = FakeSender();
    now_ = kStart;
    begin();
    play(6);
    EXPECT_EQ(receiver.undecodable, 0);
    EXPECT_GT(receiver.poses.size(), 10U);
    for (const auto& pose : receiver.poses) EXPECT_EQ(pose.key.bands, 1);
    stream_.unwatch(receiver);
  }
}

TEST_F(RateModesTest, UnfitSchemesAreRefused) {
  FakeReceiver receiver;
  const auto refused = [&](const Profile& profile, std::string_view word) {
    const auto watched = stream_.watch(receiver, profile);
    ASSERT_FALSE(watched);
    EXPECT_EQ(watched.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(watched.error().message.find(word), std::string::npos) << watched.error().message;
  };
  refused(interpolated(Scheme::kCatmullRom, Form::kCompact), "form=full");
  refused(interpolated(Scheme::kDamped), "catmull-rom");
  refused(estimated(Scheme::kHermite), "damped or linear");
  EXPECT_EQ(stream_.watchers(), 0U);
}

}  // namespace
}  // namespace eigencast::broker
