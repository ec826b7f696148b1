// SPDX-License-Identifier: MIT
#include "broker/relay/profile_budget.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

#include "tests/unit/broker/relay/stream_scene.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using Form = Profile::Form;
using Rate = Profile::Rate;
using Scheme = Profile::Scheme;

constexpr std::size_t kBudget = 20;

Profile made(Rate rate, int k, Form form, int bands, Scheme scheme) {
  return {rate, static_cast<std::uint8_t>(k), form, static_cast<std::uint8_t>(bands), scheme};
}

Profile full(int k, int bands = 8, Scheme scheme = Scheme::kLinear) {
  return made(Rate::kInterpolated, k, Form::kFull, bands, scheme);
}

Profile compact(int k, int bands = 8, Scheme scheme = Scheme::kLinear) {
  return made(Rate::kInterpolated, k, Form::kCompact, bands, scheme);
}

Profile raw(int bands = 8) {
  return {.rate = Rate::kRaw, .bands = static_cast<std::uint8_t>(bands)};
}

/// All that a viewer may ask for, the costly ones first.
std::vector<Profile> all_profiles() {
  std::vector<Profile> all;
  for (int k = 15; k >= 2; --k) {
    for (const Rate rate : {Rate::kInterpolated, Rate::kEstimated, Rate::kRaw}) {
      for (const Form form : {Form::kFull, Form::kCompact}) {
        for (int bands = 8; bands >= 1; --bands) {
          for (const Scheme scheme : {Scheme::kLinear, Scheme::kCatmullRom, Scheme::kHermite, Scheme::kDamped}) {
            if (const Profile profile = made(rate, k, form, bands, scheme); check_profile(profile)) {
              all.push_back(profile);
            }
          }
        }
      }
    }
  }
  return all;
}

TEST(ProfileBudgetTest, ProfileCostsOneAndItsEncodedPoses) {
  EXPECT_EQ(cost_of(full(3)), 3u);
  EXPECT_EQ(cost_of(full(15)), 15u);
  EXPECT_EQ(cost_of(compact(15)), 1u);
  EXPECT_EQ(cost_of(made(Rate::kEstimated, 4, Form::kFull, 8, Scheme::kDamped)), 5u);
}

TEST(ProfileBudgetTest, NearestIsServedAndTakesNoMore) {
  const std::vector<Profile> served{full(5), full(9, 2), full(8, 8, Scheme::kHermite), compact(12), compact(7, 4)};
  EXPECT_EQ(nearest_profile(full(6), served), full(5)) << "fewer poses";
  EXPECT_EQ(nearest_profile(full(4), served), full(3)) << "the common one, though x5 is served";
  EXPECT_EQ(nearest_profile(full(15, 2), served), full(9, 2));
  EXPECT_EQ(nearest_profile(full(9, 8, Scheme::kHermite), served), full(8, 8, Scheme::kHermite));
  EXPECT_EQ(nearest_profile(full(7, 8, Scheme::kCatmullRom), served), full(5)) << "the default scheme";
  EXPECT_EQ(nearest_profile(compact(15), served), compact(12)) << "never full where compact was asked for";
  EXPECT_EQ(nearest_profile(compact(9, 5), served), compact(3, 5)) << "bands last";
  EXPECT_EQ(nearest_profile(full(2), served), raw()) << "x3 has more poses";
  EXPECT_EQ(nearest_profile(made(Rate::kEstimated, 2, Form::kFull, 8, Scheme::kDamped), served), raw());
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
  for (FakeReceiver& receiver : receivers) EXPECT_EQ(watch(receiver, full(15)).k, 15);
  FakeReceiver other;
  EXPECT_EQ(watch(other, full(10)).k, 3);
  EXPECT_EQ(watch(other, full(5)).k, 5) << "15 + 5";
  EXPECT_EQ(watch(other, full(5, 8, Scheme::kCatmullRom)).scheme, Scheme::kCatmullRom) << "it gave up its former one";
}

TEST_F(StreamBudgetTest, ViewerGetsItsProfileOnceThereIsRoom) {
  announce();
  FakeReceiver early, late;
  watch(early, full(15));
  EXPECT_EQ(watch(late, full(10)).k, 3);
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
  const Profile asked = full(14);
  ASSERT_TRUE(stream.watch(modest, asked));
  EXPECT_EQ(modest.infos.back().profile, full(14, 2)) << "others have theirs";
  ASSERT_TRUE(stream.watch(refused, full(13)));
  EXPECT_NE(refused.infos.back().profile, full(13, 2));
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
  EXPECT_EQ(refused.infos.back().profile, full(13, 2));
  stream.unwatch(refused);
  stream.unwatch(modest);
  EXPECT_EQ(encoded.used(), 0);
}

}  // namespace
}  // namespace eigencast::broker
