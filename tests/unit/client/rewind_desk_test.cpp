// SPDX-License-Identifier: MIT
#include "client/rewind_desk.h"

#include <gtest/gtest.h>

#include "client/hud_text.h"
#include "tests/unit/client/past_source.h"

namespace eigencast {
namespace {

using testing::kBrokerUs, testing::kSecond, testing::PastSource;

/// A viewer of it, at times of a test's own.
struct Desk {
  void turn(TimeUs passed_us = 60'000) {
    now_us += passed_us;
    desk.take(state);
    desk.advance(sources, scene, now_us);
  }
  TimeUs broker_us() const { return kBrokerUs + now_us; }

  PastSource source;
  std::vector<PoseSource*> sources{&source};
  Scene scene{{Placement{}}, SceneOptions{}};
  RewindDesk desk;
  ViewerState state;
  TimeUs now_us = 0;
};

TEST(RewindDesks, SayHowFarTheyAreBehind) {
  EXPECT_EQ(text_from_behind(12'340'000), "12.3 s behind live");
  EXPECT_EQ(text_from_behind(187 * kSecond), "3:07 behind live");
  EXPECT_EQ(text_from_behind(3727 * kSecond), "1:02:07 behind live");
  EXPECT_EQ(text_from_behind(-5), "0.0 s behind live");
}

TEST(RewindDesks, HaveNoBarWithoutAPastAndSayWhy) {
  Desk d;
  d.source.kept_.reset();
  d.turn(2 * kSecond);
  EXPECT_FALSE(d.desk.bar());
  EXPECT_EQ(d.source.asked, 0) << "nobody wants it";
  d.state.steps = -1;
  d.turn(2 * kSecond);
  EXPECT_EQ(d.source.asked, 1);
  d.source.kept_ = Rewind::Kept{kBrokerUs, 0, {}, "may not (refused)", 1};
  d.turn();
  EXPECT_EQ(d.desk.take_trouble(), "may not (refused)");
  EXPECT_EQ(d.desk.take_trouble(), "");
  EXPECT_FALSE(d.desk.bar());
  EXPECT_TRUE(d.source.seeks.empty());
}

TEST(RewindDesks, AskAgainWhereNothingIsKeptYet) {
  Desk d;
  d.source.kept_->spans.clear();
  d.turn(2 * kSecond), d.turn(2 * kSecond);
  EXPECT_EQ(d.source.asked, 2);
  EXPECT_FALSE(d.desk.bar());
  d.source.kept_->spans = {{kBrokerUs, kBrokerUs + kSecond}};
  d.turn();
  EXPECT_TRUE(d.desk.bar());
}

TEST(RewindDesks, SeekAtMostEveryTwentiethSecond) {
  Desk d;
  d.turn();
  ASSERT_TRUE(d.desk.bar());
  EXPECT_FALSE(d.desk.bar()->is_past);
  EXPECT_EQ(d.desk.bar()->now_us, d.broker_us());
  for (int i = 0; i < 5; ++i) {
    d.state.seek_us = kBrokerUs - (30 + i) * kSecond;
    d.turn(10'000);
  }
  ASSERT_EQ(d.source.seeks.size(), 1U);
  d.turn(50'000);
  ASSERT_EQ(d.source.seeks.size(), 2U);
  EXPECT_EQ(d.source.seeks[1].at_us, kBrokerUs - 34 * kSecond);
  EXPECT_EQ(d.source.seeks[1].speed, 1);
  EXPECT_FALSE(d.desk.is_settled());
  EXPECT_EQ(d.desk.past_us(), kBrokerUs - 34 * kSecond) << "soon";
  d.source.answer(kBrokerUs - 34 * kSecond - 7);
  d.turn();
  EXPECT_TRUE(d.desk.is_settled());
  EXPECT_EQ(d.desk.past_us(), kBrokerUs - 34 * kSecond - 7);
}

TEST(RewindDesks, MomentsFollowTheSpeedOfWhatIsShown) {
  Desk d;
  d.turn();
  d.state.seek_us = kBrokerUs - 30 * kSecond;
  d.state.speed = 0.5;
  d.turn();
  d.source.answer(kBrokerUs - 30 * kSecond);
  d.scene.receive(0, d.source, {testing::sphere_pose(d.source.asset_, 0, 1'005'000, 1, 0, d.source.epoch_)});
  ASSERT_TRUE(d.scene.advance(d.sources, d.now_us));
  d.turn();
  EXPECT_EQ(d.desk.past_us(), kBrokerUs - 30 * kSecond + kSecond / 2);
}

TEST(RewindDesks, PauseHoldsThePictureAndGoesOnFromThere) {
  Desk d;
  d.turn();
  d.state.paused = true;
  d.turn();
  EXPECT_TRUE(d.desk.holds());
  EXPECT_TRUE(d.source.seeks.empty());
  const TimeUs at_us = d.desk.past_us().value();
  EXPECT_NEAR(static_cast<double>(at_us), static_cast<double>(d.broker_us()), 200'000);
  d.turn(10 * kSecond);
  EXPECT_EQ(d.desk.past_us(), at_us);
  d.state.paused = false;
  d.turn();
  EXPECT_FALSE(d.desk.holds());
  ASSERT_EQ(d.source.seeks.size(), 1U);
  EXPECT_EQ(d.source.seeks[0].at_us, at_us);
  d.source.answer(at_us);
  d.turn();
  d.state.paused = true;
  d.turn();
  EXPECT_TRUE(d.desk.holds());
  ASSERT_EQ(d.source.seeks.size(), 2U);
  EXPECT_EQ(d.source.seeks[1].speed, 0) << "the broker need not go on";
}

TEST(RewindDesks, StepsWaitForOneAnother) {
  Desk d;
  d.turn();
  d.state.steps = -2;
  d.turn();
  EXPECT_TRUE(d.state.paused);
  EXPECT_FALSE(d.desk.holds());
  ASSERT_EQ(d.source.seeks.size(), 1U);
  EXPECT_EQ(d.source.seeks[0].speed, 0);
  EXPECT_FALSE(d.source.seeks[0].next);
  d.turn();
  ASSERT_EQ(d.source.seeks.size(), 1U);
  d.source.answer(kBrokerUs - 100);
  d.turn();
  ASSERT_EQ(d.source.seeks.size(), 2U);
  EXPECT_EQ(d.source.seeks[1].at_us, kBrokerUs - 101);
  d.source.answer(kBrokerUs - 200);
  d.state.steps = 1;
  d.turn();
  ASSERT_EQ(d.source.seeks.size(), 3U);
  EXPECT_EQ(d.source.seeks[2].at_us, kBrokerUs - 200);
  EXPECT_TRUE(d.source.seeks[2].next);
}

TEST(RewindDesks, NothingIsFasterThanLive) {
  Desk d;
  d.turn();
  d.state.speed = 2;
  d.turn();
  EXPECT_EQ(d.state.speed, 1);
  EXPECT_TRUE(d.source.seeks.empty());
  d.state.speed = 0.5;
  d.turn();
  ASSERT_EQ(d.source.seeks.size(), 1U);
  EXPECT_EQ(d.source.seeks[0].speed, 0.5);
  d.source.answer(d.source.seeks[0].at_us);
  d.turn(10 * kSecond);
  d.state.speed = 2;
  d.turn();
  ASSERT_EQ(d.source.seeks.size(), 2U);
  EXPECT_EQ(d.source.seeks[1].speed, 2);
}

TEST(RewindDesks, GoBackToLive) {
  Desk d;
  d.turn();
  d.state.seek_us = kBrokerUs - 30 * kSecond;
  d.state.paused = true;
  d.turn();
  d.source.answer(kBrokerUs - 30 * kSecond);
  d.turn();
  d.state.live_wanted = true;
  d.turn();
  EXPECT_EQ(d.source.presents, 1);
  d.source.go_live();
  d.turn();
  EXPECT_FALSE(d.desk.past_us());
  EXPECT_FALSE(d.state.paused);
  d.state.seek_us = d.broker_us() - kSecond / 2;
  d.turn();
  EXPECT_TRUE(d.source.seeks.size() == 1 && !d.desk.past_us()) << "as good as now";
}

TEST(RewindDesks, AreLiveWhereTheBrokerIsAndComeBackOnANewConnection) {
  Desk d;
  d.turn();
  d.state.seek_us = d.broker_us() - 2 * kSecond;
  d.turn();
  d.source.answer(d.source.seeks[0].at_us);
  d.turn();
  d.source.go_live();
  d.turn();
  EXPECT_FALSE(d.desk.past_us()) << "it has come to the end";
  d.state.seek_us = kBrokerUs - 30 * kSecond;
  d.turn();
  d.source.answer(kBrokerUs - 30 * kSecond);
  d.turn();
  d.source.kept_.reset();
  d.turn();
  d.source.kept_ = Rewind::Kept{kBrokerUs, 0, {{kBrokerUs - 60 * kSecond, kBrokerUs}}, "", 0};
  d.source.go_live();
  d.turn(), d.turn();
  ASSERT_EQ(d.source.seeks.size(), 3U);
  EXPECT_EQ(d.source.seeks[2].at_us, kBrokerUs - 30 * kSecond);
}

TEST(RewindDesks, RefusedSeeksLeaveWhatIsShown) {
  Desk d;
  d.turn();
  d.state.seek_us = kBrokerUs - 30 * kSecond;
  d.turn();
  d.source.kept_->refusals = 1;
  d.source.kept_->trouble = "too many (refused)";
  d.turn();
  EXPECT_EQ(d.desk.take_trouble(), "too many (refused)");
  EXPECT_FALSE(d.desk.past_us());
  EXPECT_TRUE(d.desk.is_settled());
}

TEST(RewindDesks, FollowersGoWhereTheyAreNot) {
  Desk lead, follower;
  for (Desk* d : {&lead, &follower}) d->turn();
  EXPECT_FALSE(lead.desk.led().at_us);
  lead.state.seek_us = kBrokerUs - 30 * kSecond;
  lead.turn();
  ASSERT_TRUE(lead.desk.led().at_us);
  follower.desk.follow(lead.desk.led());
  follower.turn();
  ASSERT_EQ(follower.source.seeks.size(), 1U);
  EXPECT_EQ(follower.source.seeks[0].at_us, kBrokerUs - 30 * kSecond);
  follower.source.answer(kBrokerUs - 30 * kSecond);
  follower.turn();
  follower.desk.follow({kBrokerUs - 30 * kSecond + 100'000, 1});
  follower.turn();
  EXPECT_EQ(follower.source.seeks.size(), 1U) << "it is there";
  follower.desk.follow({kBrokerUs - 30 * kSecond + 100'000, 0});
  follower.turn();
  ASSERT_EQ(follower.source.seeks.size(), 2U);
  EXPECT_TRUE(follower.state.paused || (follower.turn(), follower.state.paused));
  follower.desk.follow({});
  follower.turn();
  EXPECT_EQ(follower.source.presents, 1);
  EXPECT_FALSE(follower.desk.past_us());
}

}  // namespace
}  // namespace eigencast
