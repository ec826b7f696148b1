// SPDX-License-Identifier: MIT
#include "broker/http/stream_list.h"

#include <gtest/gtest.h>

#include <list>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using Names = std::vector<std::string>;

class StreamListTest : public ::testing::Test {
 protected:
  Stream& send(const std::string& name) {
    Stream& stream = **hub_.open(name);
    EXPECT_TRUE(stream.claim(senders_.emplace_back()));
    EXPECT_TRUE(stream.announce(small_announce(), 3));
    return stream;
  }
  void watch(const std::string& name) { EXPECT_TRUE((*hub_.open(name))->watch(viewers_.emplace_back(), kRaw)); }

  nlohmann::json page(const std::string& after, std::size_t max) const {
    return nlohmann::json::parse(
        page_of_streams(hub_, after, max, [](std::string_view name) { return !name.starts_with("secret"); }));
  }
  static Names names_of(const nlohmann::json& page) {
    Names names;
    for (const auto& stream : page.at("streams")) names.push_back(stream.at("stream"));
    return names;
  }

  std::list<FakeSender> senders_;
  std::list<FakeReceiver> viewers_;
  Hub hub_{{8, {}}};
};

TEST_F(StreamListTest, NamesThatNobodyAnnouncedAreNotListed) {
  watch("invented");
  watch("lab/horse");
  EXPECT_EQ(page("", 10).dump(), R"({"streams":[]})");
  const Stream& stream = send("lab/horse");
  const auto listed = page("", 10).at("streams");
  ASSERT_EQ(listed.size(), 1u);
  const control::Announce announced = small_announce();
  EXPECT_EQ(listed[0], (nlohmann::json{{"stream", "lab/horse"},
                                       {"stream_id", stream.id()},
                                       {"state", "live"},
                                       {"epoch", 3},
                                       {"asset", announced.asset},
                                       {"key_rate_hz", announced.key_rate_hz},
                                       {"keys_received", 0},
                                       {"subscribers", 1}}));
}

TEST_F(StreamListTest, PagesFollowOneAnotherByName) {
  for (const char* name : {"e", "a", "secret/1", "c", "secret/2"}) send(name);
  watch("b");
  const auto first = page("", 2);
  EXPECT_EQ(names_of(first), (Names{"a", "c"}));
  EXPECT_EQ(first.at("next"), "c");
  const auto second = page(first.at("next"), 2);
  EXPECT_EQ(names_of(second), (Names{"e"}));
  EXPECT_FALSE(second.contains("next")) << "no name that the caller may not see";
  EXPECT_FALSE(page("", 3).contains("next"));
  EXPECT_EQ(names_of(page("aa", 9)), (Names{"c", "e"})) << "a name that is gone";
  EXPECT_EQ(names_of(page("z", 9)), Names());
}

}  // namespace
}  // namespace eigencast::broker
