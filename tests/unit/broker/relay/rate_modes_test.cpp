// SPDX-License-Identifier: MIT
//
// What each rate mode and scheme delivers, pose by pose, on a fake clock.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <tuple>

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

constexpr TimeUs kStart = 1'000'000;

Profile interpolated(Scheme scheme, std::uint8_t k = 3) {
  return {Profile::Rate::kInterpolated, k, 8, scheme};
}
Profile estimated(Scheme scheme) {
  return {Profile::Rate::kEstimated, 3, 8, scheme};
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
    if (pose.envelope.step.at == pose.envelope.step.of) {
      EXPECT_EQ(pose.key, key_number(s));
      continue;
    }
    // The last interval never has its further key; all others have.
    const Key expected = blended(s, pose.envelope.capture_us, s < 11);
    for (std::size_t i = 0; i < expected.q.size(); ++i) EXPECT_NEAR(pose.key.q[i], expected.q[i], 1) << s << " " << i;
  }
}

/// A feed of one profile and the frames that it makes of keys 30 ms apart.
class FeedTest : public ::testing::Test {
 protected:
  FeedTest() : FeedTest(interpolated(Scheme::kLinear)) {}
  explicit FeedTest(const Profile& profile)
      : feed_(profile, Feed::Source{small_layout(), {}, 7, 1}, [](double) { return true; }) {}
  void key_comes(int s) {
    auto record = std::make_shared<KeyRecord>();
    record->sequence = static_cast<std::uint64_t>(s);
    record->capture_us = record->arrival_us = now_us_ = kStart + s * kInterval;
    record->bands = 3;
    record->join = newest_ == nullptr;
    record->before = newest_;
    newest_ = std::make_shared<const ChainState>(
        ChainState{newest_ ? newest_->newer : key_number(s), key_number(s), newest_ ? kInterval : 0});
    record->after = newest_;
    record->payload = record->join ? encode_join(small_layout(), *newest_).value()
                                   : encode_key(small_layout(), *record->before, key_number(s), 0)->payload;
    feed_.add_key(record, now_us_, out_);
  }
  /// Kind, ahead or not, and step of what came since.
  using Made = std::vector<std::tuple<FrameKind, bool, InterpolationStep>>;
  Made take() {
    Made made;
    for (const FramePtr& frame : std::exchange(out_, {}))
      made.emplace_back(frame->envelope.kind, frame->envelope.is_ahead(), frame->envelope.step);
    return made;
  }

  Feed feed_;
  std::vector<FramePtr> out_;
  TimeUs now_us_ = kStart;
  std::shared_ptr<const ChainState> newest_;
};

TEST_F(FeedTest, KeyShowsTheFirstPoseThatIsNotOvertaken) {
  key_comes(0);
  EXPECT_EQ(take(), (Made{{FrameKind::kJoin, false, {}}}));
  key_comes(1);
  EXPECT_EQ(take(), (Made{{FrameKind::kKey, true, {1, 3}}})) << "due at once";
  feed_.pump(now_us_ + kInterval / 3 - 1, out_);
  EXPECT_EQ(take(), Made{}) << "a step leaves when it is due, not before";
  feed_.pump(now_us_ + kInterval / 3, out_);
  EXPECT_EQ(take(), (Made{{FrameKind::kStep, false, {2, 3}}}));
  EXPECT_EQ(feed_.join()->envelope.step, (InterpolationStep{2, 3})) << "what is shown now";
  EXPECT_TRUE(feed_.join()->envelope.is_ahead());
  key_comes(2);  // The last step of key 1 is due since 10 ms, so is a pose of key 2.
  EXPECT_EQ(take(), (Made{{FrameKind::kKey, true, {1, 3}}}));
  feed_.pump(now_us_ + kInterval * 2 / 3, out_);
  EXPECT_EQ(take(), (Made{{FrameKind::kStep, false, {3, 3}}})) << "of two the newest";
  EXPECT_FALSE(feed_.join()->envelope.is_ahead());
  feed_.pump(now_us_ + 2 * kInterval, out_);
  EXPECT_EQ(take(), Made{});
}

// All bands are coded before those are cut that a profile does not have.
TEST_F(FeedTest, AJoinOfFewBandsCostsWhatAllTake) {
  key_comes(0);
  Profile lowest = interpolated(Scheme::kLinear);
  lowest.bands = 1;
  Feed few(lowest, Feed::Source{small_layout(), {}, 7, 1}, [](double) { return true; });
  std::vector<FramePtr> out;
  KeyRecord first{.bands = 3, .join = true, .before = {}, .after = newest_, .payload = {}};
  first.payload = encode_join(small_layout(), *newest_).value();
  few.add_key(std::make_shared<KeyRecord>(std::move(first)), kStart, out);
  few.pump(kStart + 10 * kInterval, out);
  feed_.pump(kStart + 10 * kInterval, out_);
  double whole_us = 0, cut_us = 0;
  const FramePtr whole = feed_.join(&whole_us), cut = few.join(&cut_us);
  ASSERT_TRUE(whole && cut);
  EXPECT_LT(cut->wire.size(), whole->wire.size());
  EXPECT_EQ(cut_us, whole_us);
}

TEST_F(FeedTest, JoinIsEncodedOnceForAllItsSteps) {
  key_comes(0);
  key_comes(1);
  double work_us = 0;
  const FramePtr first = feed_.join(&work_us);
  EXPECT_GT(std::exchange(work_us, 0), 0);
  EXPECT_EQ(feed_.join(&work_us), first);
  feed_.pump(now_us_ + kInterval / 3, out_);
  const auto payload_of = [](const FramePtr& frame) {
    const ByteView payload = parse_frame(frame->message())->payload;
    return Bytes(payload.begin(), payload.end());
  };
  EXPECT_NE(feed_.join(&work_us), first);
  EXPECT_EQ(payload_of(feed_.join(&work_us)), payload_of(first));
  EXPECT_EQ(work_us, 0);
}

class CurvedFeedTest : public FeedTest {
 protected:
  CurvedFeedTest() : FeedTest(interpolated(Scheme::kCatmullRom)) {}
};

TEST_F(CurvedFeedTest, ResidualsFollowAKeyThatShowsNothing) {
  for (int s = 0; s < 3; ++s) key_comes(s);
  (void)take();
  key_comes(3);
  feed_.pump(now_us_ + kInterval / 3, out_);
  const std::vector<FramePtr> frames = out_;
  EXPECT_EQ(take(),
            (Made{{FrameKind::kKey, true, {}}, {FrameKind::kStep, false, {1, 3}}, {FrameKind::kStep, false, {2, 3}}}));
  EXPECT_EQ(frames[0]->envelope.sequence, 2u) << "held back until key 3 had come";
  EXPECT_FALSE(frames[1]->envelope.bands.empty());
  EXPECT_EQ(feed_.join()->envelope.step, InterpolationStep{}) << "a join has no residual";
}

TEST_F(RateModesTest, CatmullRomDoesNotWaitForLateKey) {
  std::mt19937 random(5);
  std::uniform_int_distribution<TimeUs> jitter(0, 12'000);
  class Timed : public FakeReceiver {
   public:
    explicit Timed(const TimeUs& now) : now_(now) {}
    void on_frame(const FramePtr& frame) override {
      FakeReceiver::on_frame(frame);
      if (frame->envelope.shows()) written_us.push_back(now_);
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
  ASSERT_EQ(receiver.poses.size(), receiver.written_us.size());
  for (std::size_t i = 0; i < receiver.poses.size(); ++i) {
    const TimeUs age_us = receiver.written_us[i] - receiver.poses[i].envelope.capture_us;
    EXPECT_LE(age_us, 3 * kInterval + 16'000);
  }
}

TEST_F(RateModesTest, HermiteBendsByVelocities) {
  FakeReceiver linear, hermite;
  ASSERT_TRUE(stream_.watch(linear, interpolated(Scheme::kLinear, 5)));
  ASSERT_TRUE(stream_.watch(hermite, interpolated(Scheme::kHermite, 5)));
  begin(1);
  play(10);
  EXPECT_EQ(hermite.undecodable, 0);
  ASSERT_EQ(hermite.poses.size(), 1U + 5 * 9);
  ASSERT_EQ(linear.poses.size(), hermite.poses.size());
  int bent = 0;
  for (std::size_t i = 0; i < hermite.poses.size(); ++i) {
    EXPECT_EQ(linear.poses[i].envelope.capture_us, hermite.poses[i].envelope.capture_us);
    const int s = static_cast<int>(hermite.poses[i].envelope.sequence);
    const auto [at, of] = hermite.poses[i].envelope.step;
    if (at == of) continue;
    EXPECT_EQ(hermite.poses[i].key,
              hermite_keys(small_layout(), {1, 10'000}, key_number(s - 1), key_number(s), kInterval, at, of).value());
    if (hermite.poses[i].key != linear.poses[i].key) ++bent;
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
    FakeReceiver raw, receiver;
    ASSERT_TRUE(stream_.watch(raw, {Profile::Rate::kRaw}));
    ASSERT_TRUE(stream_.watch(receiver, estimated(scheme)));
    sender_ = FakeSender();
    begin();
    now_ = kStart;
    play(10);
    EXPECT_EQ(receiver.undecodable, 0);
    // 10 keys, two estimates after each of the first eight that have a direction, and 200 ms = 20 thirds after the
    // last, of which the envelope numbers 15.
    ASSERT_EQ(receiver.poses.size(), 10U + 2 * 8 + 15);
    int keys = 0;
    for (std::size_t i = 0; i < receiver.poses.size(); ++i) {
      const auto& [head, pose] = receiver.poses[i];
      const int s = static_cast<int>(head.sequence);
      if (head.kind != FrameKind::kEstimate) {
        EXPECT_EQ(pose, key_number(s));
        EXPECT_EQ(head.capture_us, kStart + keys++ * kInterval);
        continue;
      }
      EXPECT_EQ(head.capture_us, kStart + s * kInterval + head.step.at * kInterval / 3);
      EXPECT_EQ(receiver.frames[i]->message().size(), 5U) << "no payload, no time";
      const Key expected = estimate_keys(small_layout(), key_number(s - 1), key_number(s), scheme == Scheme::kDamped,
                                         head.step.at, head.step.of)
                               .value();
      EXPECT_EQ(pose, expected);
    }
    EXPECT_EQ(keys, 10);
    // Nothing is held: keys leave as in raw mode.
    EXPECT_EQ(raw.poses.size(), 10U);
    stream_.unwatch(raw);
    stream_.unwatch(receiver);
  }
}

TEST_F(RateModesTest, EstimatesNeverRunBackAfterLateKey) {
  FakeReceiver receiver;
  ASSERT_TRUE(stream_.watch(receiver, estimated(Scheme::kDamped)));
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

TEST_F(RateModesTest, BandsAreCutFromPosesBetween) {
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
  refused(interpolated(Scheme::kDamped), "catmull-rom");
  refused(estimated(Scheme::kHermite), "damped or linear");
  EXPECT_EQ(stream_.watchers(), 0U);
}

}  // namespace
}  // namespace eigencast::broker
