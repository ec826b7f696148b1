// SPDX-License-Identifier: MIT
#include "broker/relay/profile_budget.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

#include "tests/unit/broker/relay/stream_scene.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using Rate = Profile::Rate;
using Scheme = Profile::Scheme;

constexpr std::size_t kBudget = 20;

Profile made(Rate rate, int k, int bands, Scheme scheme) {
  return {rate, static_cast<std::uint8_t>(k), static_cast<std::uint8_t>(bands), scheme};
}

Profile linear(int k, int bands = 8) {
  return made(Rate::kInterpolated, k, bands, Scheme::kLinear);
}

Profile curved(int k, int bands = 8) {
  return made(Rate::kInterpolated, k, bands, Scheme::kCatmullRom);
}

Profile hermite(int k) {
  return made(Rate::kInterpolated, k, 8, Scheme::kHermite);
}

Profile raw(int bands = 8) {
  return {.rate = Rate::kRaw, .bands = static_cast<std::uint8_t>(bands)};
}

/// All that a viewer may ask for, the costly ones first.
std::vector<Profile> all_profiles() {
  std::vector<Profile> all;
  for (int k = 15; k >= 2; --k) {
    for (const Rate rate : {Rate::kInterpolated, Rate::kEstimated, Rate::kRaw}) {
      for (int bands = 8; bands >= 1; --bands) {
        for (const Scheme scheme : {Scheme::kLinear, Scheme::kCatmullRom, Scheme::kHermite, Scheme::kDamped}) {
          if (const Profile profile = made(rate, k, bands, scheme); check_profile(profile)) all.push_back(profile);
        }
      }
    }
  }
  return all;
}

TEST(ProfileBudgetTest, ProfileCostsOneAndItsEncodedPoses) {
  EXPECT_EQ(cost_of(curved(3)), 3u);
  EXPECT_EQ(cost_of(curved(15)), 15u);
  EXPECT_EQ(cost_of(linear(15)), 1u);
  EXPECT_EQ(cost_of(made(Rate::kEstimated, 4, 8, Scheme::kDamped)), 1u);
}

TEST(ProfileBudgetTest, NearestIsServedAndTakesNoMore) {
  const std::vector<Profile> served{linear(5), linear(9, 2), hermite(8), curved(12), linear(7, 4)};
  EXPECT_EQ(nearest_profile(linear(6), served), linear(5)) << "fewer poses";
  EXPECT_EQ(nearest_profile(linear(4), served), linear(3)) << "the common one, though x5 is served";
  EXPECT_EQ(nearest_profile(linear(15, 2), served), linear(9, 2));
  EXPECT_EQ(nearest_profile(hermite(9), served), hermite(8));
  EXPECT_EQ(nearest_profile(curved(7), served), linear(5)) << "the default scheme";
  EXPECT_EQ(nearest_profile(curved(15), served), curved(12));
  EXPECT_EQ(nearest_profile(linear(15), served), linear(5)) << "never residuals where none were asked for";
  EXPECT_EQ(nearest_profile(linear(9, 5), served), linear(3, 5)) << "bands last";
  EXPECT_EQ(nearest_profile(linear(2), served), raw()) << "x3 has more poses";
  EXPECT_EQ(nearest_profile(made(Rate::kEstimated, 2, 8, Scheme::kDamped), served), raw());
}

TEST(ProfileBudgetTest, NearestOfAnythingIsBelowIt) {
  const std::vector<Profile> all = all_profiles();
  for (const Profile& asked : all) {
    const Profile nearest = nearest_profile(asked, all);
    EXPECT_TRUE(check_profile(nearest));
    EXPECT_EQ(nearest.bands, asked.bands);
    EXPECT_TRUE(nearest.rate == asked.rate || nearest.rate == Rate::kRaw);
    EXPECT_TRUE(nearest == asked || asked.rate == Rate::kRaw) << "it is served itself";
    const Profile alone = nearest_profile(asked, {});
    EXPECT_TRUE(is_common(alone));
    EXPECT_LE(alone.k, std::max<int>(asked.k, 3));
  }
}

class StreamBudgetTest : public StreamTest {
 protected:
  StreamBudgetTest() : limited_("a", 7, {.max_profiles = kBudget}) {}

  Profile watch(FakeReceiver& receiver, const Profile& asked) {
    EXPECT_TRUE(limited_.watch(receiver, asked));
    return receiver.infos.back().profile;
  }
  void announce() {
    ASSERT_TRUE(limited_.has_publisher() || limited_.claim(sender_));
    ASSERT_TRUE(limited_.announce(small_announce(), ++epoch_));
    sender_.tag = limited_.tag();
  }

  Stream limited_;
};

TEST_F(StreamBudgetTest, ManyProfilesCostNoMoreThanTheBudget) {
  const std::vector<Profile> all = all_profiles();
  std::vector<FakeReceiver> receivers(all.size());
  for (std::size_t i = 0; i < all.size() / 2; ++i) watch(receivers[i], all[i]);  // Some before the sender.
  for (const bool again : {false, true}) {
    announce();
    for (std::size_t i = all.size() / 2; i < all.size(); ++i) watch(receivers[i], all[i]);
    std::set<Profile> served;
    std::size_t cost = 0;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const Profile got = receivers[i].infos.back().profile;
      EXPECT_TRUE(got.rate == all[i].rate || !is_common(all[i])) << "nobody's wishes cost others a common profile";
      EXPECT_LE(got.bands, all[i].bands);
      if (served.insert(got).second && !is_common(got)) cost += cost_of(got);
    }
    EXPECT_EQ(served.size(), limited_.profile_count());
    EXPECT_LE(cost, kBudget) << again;
    EXPECT_GT(cost, kBudget / 2);
  }
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(limited_.add_frame(sender_.next(now_), now_));
    for (const TimeUs end = now_ + kInterval; now_ < end; now_ += 1000) limited_.pump(now_);
  }
  for (const FakeReceiver& receiver : receivers) {
    EXPECT_EQ(receiver.undecodable, 0);
    EXPECT_FALSE(receiver.poses.empty());
  }
}

TEST_F(StreamBudgetTest, ServedProfileTakesNoMoreBudget) {
  announce();
  std::vector<FakeReceiver> receivers(100);
  for (FakeReceiver& receiver : receivers) EXPECT_EQ(watch(receiver, curved(15)).k, 15);
  FakeReceiver other;
  EXPECT_EQ(watch(other, curved(10)).k, 3);
  EXPECT_EQ(watch(other, curved(5)).k, 5) << "15 + 5";
  EXPECT_EQ(watch(other, curved(4)).scheme, Scheme::kCatmullRom) << "it gave up its former one";
}

TEST_F(StreamBudgetTest, ViewerGetsItsProfileOnceThereIsRoom) {
  announce();
  FakeReceiver early, late;
  watch(early, curved(15));
  EXPECT_EQ(watch(late, curved(10)).k, 3);
  EXPECT_FALSE(limited_.improve(late));
  EXPECT_EQ(late.infos.back().profile.k, 3);
  limited_.unwatch(early);
  EXPECT_TRUE(limited_.improve(late));
  EXPECT_EQ(late.infos.back().profile.k, 10);
  EXPECT_FALSE(limited_.improve(late));
}

TEST_F(StreamBudgetTest, MemoryOfProfilesIsShared) {
  Stream::Settings settings;
  settings.max_bytes = 100'000;
  settings.max_profiles = 10'000;
  Stream stream("a", 7, settings);
  ASSERT_TRUE(stream.claim(sender_));
  ASSERT_TRUE(stream.announce(small_announce(), ++epoch_));
  const std::vector<Profile> all = all_profiles();
  std::vector<FakeReceiver> greedy(all.size(), FakeReceiver("greedy"));
  for (std::size_t i = 0; i < all.size(); ++i) ASSERT_TRUE(stream.watch(greedy[i], all[i]));
  const Shares& encoded = settings.memory->encoded;
  const std::int64_t each = encoded_bytes(small_layout(), raw(2));
  EXPECT_LE(encoded.used(), settings.max_bytes / 4 + 2 * each) << "and raw keys, which nobody is refused";
  EXPECT_GE(encoded.used(), settings.max_bytes / 5 - 2 * each);
  FakeReceiver modest("modest"), refused("greedy");
  const Profile asked = linear(12);
  ASSERT_TRUE(stream.watch(modest, asked));
  EXPECT_EQ(modest.infos.back().profile, linear(12, 2)) << "others have theirs";
  ASSERT_TRUE(stream.watch(refused, linear(11)));
  EXPECT_NE(refused.infos.back().profile, linear(11, 2));
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(stream.add_frame(sender_.next(now_), now_));
    for (const TimeUs end = now_ + kInterval; now_ < end; now_ += 1000) stream.pump(now_);
  }
  for (const FakeReceiver& receiver : greedy) {
    EXPECT_EQ(receiver.undecodable, 0);
    EXPECT_FALSE(receiver.poses.empty());
  }
  for (FakeReceiver& receiver : greedy) stream.unwatch(receiver);
  EXPECT_TRUE(stream.improve(refused));
  EXPECT_EQ(refused.infos.back().profile, linear(11, 2));
  stream.unwatch(refused);
  stream.unwatch(modest);
  EXPECT_EQ(encoded.used(), 0);
}

}  // namespace
}  // namespace eigencast::broker
