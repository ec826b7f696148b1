// SPDX-License-Identifier: MIT
//
// An epoch that continues the one before: what viewers are told, when it may begin, and that poses go on.
#include <gmock/gmock.h>

#include <list>

#include "broker/relay/outbox.h"
#include "tests/unit/broker/relay/stream_scene.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using Next = control::StreamInfo::Next;

const std::string kNextAsset(64, 'b');

class ChangeOver : public StreamTest {
 protected:
  static NextPtr next(const std::string& asset = kNextAsset) { return std::make_shared<const Next>(Next{asset, 1}); }
  /// The tag of the epoch to come.
  std::uint8_t announce_next() {
    control::Announce announce = small_announce();
    announce.asset = kNextAsset;
    announce.continues = true;
    return stream_.announce_next(announce, ++epoch_, "secret").value();
  }
};

TEST_F(ChangeOver, PoseAfterPoseComesInTimeAcrossTheChange) {
  FakeReceiver raw, made;
  begin();
  ASSERT_TRUE(stream_.watch(raw, kRaw));
  ASSERT_TRUE(stream_.watch(made, kLinear));
  play(6);
  stream_.prepare(next());
  EXPECT_EQ(raw.infos.back().next, (Next{kNextAsset, 1}));
  EXPECT_EQ(raw.infos.back().epoch, 1u);
  play(2);
  const std::uint8_t tag = announce_next();
  play(2);
  EXPECT_EQ(stream_.epoch(), 1u) << "what goes on is the present epoch";
  EXPECT_EQ(stream_.resume(), "");
  ASSERT_TRUE(stream_.add_frame(sender_.carry_on(tag, now_), now_));
  EXPECT_EQ(stream_.epoch(), 2u);
  EXPECT_EQ(stream_.resume(), "secret");
  EXPECT_EQ(raw.infos.back().asset, kNextAsset);
  EXPECT_FALSE(raw.infos.back().next);
  wait(kInterval);
  play(5);
  for (const FakeReceiver* receiver : {&raw, &made}) EXPECT_EQ(receiver->undecodable, 0);
  ASSERT_EQ(raw.poses.size(), 16u);
  for (int i = 0; i < 16; ++i) EXPECT_EQ(raw.poses[static_cast<std::size_t>(i)].key, key_number(i)) << i;
  // A viewer of made poses misses those that were still to come of the old epoch, and none of the new one.
  TimeUs longest = 0;
  for (std::size_t i = 1; i < made.poses.size(); ++i) {
    const TimeUs gap = made.poses[i].envelope.capture_us - made.poses[i - 1].envelope.capture_us;
    EXPECT_GT(gap, 0) << i;
    longest = std::max(longest, gap);
  }
  EXPECT_LE(longest, kInterval);
  const auto first =
      std::find_if(made.poses.begin(), made.poses.end(), [](const auto& p) { return p.envelope.epoch == 2; });
  ASSERT_NE(first, made.poses.end());
  EXPECT_EQ(first->envelope.step, (InterpolationStep{1, 3})) << "it moves on from the older key of the first frame";
}

TEST_F(ChangeOver, OldFramesAfterTheNewEpochAreRefused) {
  begin();
  play(2);
  FakeSender late = sender_;
  ASSERT_TRUE(stream_.add_frame(sender_.carry_on(announce_next(), now_), now_));
  EXPECT_FALSE(stream_.add_frame(late.next(now_ + 1), now_ + 1));
}

TEST_F(ChangeOver, NineOfTenViewersOrHalfAMinuteAreEnough) {
  begin();
  std::list<FakeReceiver> viewers(20);
  for (FakeReceiver& viewer : viewers) ASSERT_TRUE(stream_.watch(viewer, kRaw));
  stream_.note_prepared(viewers.front(), kNextAsset);
  stream_.prepare(next());
  EXPECT_FALSE(stream_.is_prepared(0));
  EXPECT_TRUE(stream_.is_prepared(Stream::kMostPrepareUs));
  int told = 0;
  for (FakeReceiver& viewer : viewers) {
    stream_.note_prepared(viewer, std::string(64, 'c'));
    EXPECT_EQ(stream_.is_prepared(0), told >= 18) << "another asset, or said before it was asked for";
    stream_.note_prepared(viewer, kNextAsset);
    stream_.note_prepared(viewer, kNextAsset);
    EXPECT_EQ(stream_.is_prepared(0), ++told >= 18) << told;
    ASSERT_TRUE(stream_.watch(viewer, kLinear)) << "another profile changes nothing";
    EXPECT_EQ(stream_.is_prepared(0), told >= 18) << told;
  }
  FakeReceiver stranger;
  stream_.note_prepared(stranger, kNextAsset);
  for (auto viewer = viewers.begin(); viewer != std::next(viewers.begin(), 19); ++viewer) stream_.unwatch(*viewer);
  EXPECT_TRUE(stream_.is_prepared(0));
  stream_.prepare(next(std::string(64, 'd')));
  EXPECT_FALSE(stream_.is_prepared(0)) << "nobody has that one";
  stream_.unwatch(viewers.back());
  EXPECT_TRUE(stream_.is_prepared(0)) << "nobody waits for it";
}

TEST_F(ChangeOver, ACrowdOfOneHolderDoesNotSpeakForOthers) {
  begin();
  std::list<FakeReceiver> viewers;
  for (const char* holder : {"a", "b", "c"}) viewers.emplace_back(holder);
  for (int i = 0; i < 50; ++i) viewers.emplace_back("crowd");
  for (FakeReceiver& viewer : viewers) ASSERT_TRUE(stream_.watch(viewer, kRaw));
  stream_.prepare(next());
  for (auto viewer = std::next(viewers.begin(), 3); viewer != viewers.end(); ++viewer)
    stream_.note_prepared(*viewer, kNextAsset);
  EXPECT_FALSE(stream_.is_prepared(0)) << "none of the others has it";
  for (auto viewer = viewers.begin(); viewer != std::next(viewers.begin(), 3); ++viewer) {
    EXPECT_FALSE(stream_.is_prepared(0));
    stream_.note_prepared(*viewer, kNextAsset);
  }
  EXPECT_TRUE(stream_.is_prepared(0));
  for (FakeReceiver& viewer : viewers) stream_.unwatch(viewer);
}

TEST_F(ChangeOver, SendersThatLeaveTakeTheirNextEpochAlong) {
  FakeReceiver viewer;
  begin();
  ASSERT_TRUE(stream_.watch(viewer, kRaw));
  play(2);
  stream_.prepare(next());
  stream_.note_prepared(viewer, kNextAsset);
  const std::uint8_t tag = announce_next();
  stream_.release(sender_);
  EXPECT_FALSE(viewer.infos.back().next);
  FakeSender other;
  ASSERT_TRUE(stream_.claim(other));
  ASSERT_TRUE(stream_.announce(small_announce(), ++epoch_));
  EXPECT_NE(stream_.tag(), tag);
  other.tag = tag;
  EXPECT_FALSE(stream_.add_frame(other.next(now_), now_));
  stream_.unwatch(viewer);
}

TEST_F(ChangeOver, TheSenderPaysForEachViewerOfTheNewEpoch) {
  begin();
  std::list<FakeReceiver> viewers(20);
  for (FakeReceiver& viewer : viewers) ASSERT_TRUE(stream_.watch(viewer, kRaw));
  play(2);
  stream_.prepare(next());
  const std::uint8_t tag = announce_next();
  (void)stream_.take_unpaid_us();
  ASSERT_TRUE(stream_.add_frame(sender_.carry_on(tag, now_), now_));
  EXPECT_GE(stream_.take_unpaid_us(), 20 * 10.0) << "what an announcement costs it";
  wait(kInterval);
  play(1);
  EXPECT_DOUBLE_EQ(stream_.take_unpaid_us(), 20 * Stream::kOfferUs) << "a key";
}

TEST_F(ChangeOver, ProgressIsShownAndChangesNothing) {
  FakeReceiver viewer;
  begin();
  ASSERT_TRUE(stream_.watch(viewer, kRaw));
  play(1);
  stream_.prepare(std::make_shared<const Next>(Next{{}, 0.5}));
  ASSERT_TRUE(viewer.infos.back().next);
  EXPECT_EQ(viewer.infos.back().next->progress, 0.5);
  play(2);
  EXPECT_EQ(viewer.poses.size(), 3u);
  EXPECT_EQ(viewer.undecodable, 0);
}

}  // namespace
}  // namespace eigencast::broker
