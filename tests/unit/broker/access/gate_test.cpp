// SPDX-License-Identifier: MIT
#include "broker/access/gate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <fstream>
#include <limits>
#include <thread>
#include <vector>

#include "common/core/bytes.h"
#include "tests/unit/broker/access/golden_tokens.h"

namespace eigencast::broker {
namespace {

using ::testing::HasSubstr;
using testing::kNow;
using testing::kSecret;

constexpr TimeUs kSecond = 1'000'000;

std::string token_for(const std::string& subject, std::vector<std::string> publish, std::vector<std::string> subscribe,
                      bool admin = false, std::int64_t expires_s = kNow + 60) {
  return create_token({subject, "eigencast", "", std::move(publish), std::move(subscribe), admin, kNow, expires_s},
                      TokenKey::from_secret("", kSecret).value())
      .value();
}

AccessRequest request_from(const char* peer, const std::string& token = {}) {
  AccessRequest request;
  request.peer = IpAddress::from_text(peer).value();
  if (!token.empty()) request.authorization = "Bearer " + token;
  request.host = "127.0.0.1:7490";
  return request;
}

class GateTest : public ::testing::Test {
 protected:
  GateTest() { config_.access.jwt_secret = kSecret; }

  Gate& gate() {
    if (!gate_) gate_ = std::make_unique<Gate>(AccessPolicy::from_config(config_).value());
    return *gate_;
  }
  void reload() { gate().replace_policy(AccessPolicy::from_config(config_).value()); }
  GrantPtr let_in(const AccessRequest& request, TimeUs now_us = 0) {
    auto admitted = gate().admit(request, now_us, kNow);
    if (auto* grant = std::get_if<GrantPtr>(&admitted)) return *grant;
    ADD_FAILURE() << std::get<Denial>(admitted).message;
    return nullptr;
  }
  Denial turned_away(const AccessRequest& request, TimeUs now_us = 0) {
    auto admitted = gate().admit(request, now_us, kNow);
    if (auto* denied = std::get_if<Denial>(&admitted)) return *denied;
    ADD_FAILURE() << "was let in as " << std::get<GrantPtr>(admitted)->label();
    return {};
  }

  Config config_;
  std::unique_ptr<Gate> gate_;
};

TEST_F(GateTest, AnonymousAccessIsForLoopbackOnly) {
  EXPECT_TRUE(let_in(request_from("127.0.0.1"))->may_publish("any/stream"));
  EXPECT_TRUE(let_in(request_from("::1"))->may_subscribe("any/stream"));
  EXPECT_FALSE(let_in(request_from("::1"))->may_administer());
  const Denial denied = turned_away(request_from("192.168.1.9"));
  EXPECT_EQ(denied.status, 401);
  EXPECT_FALSE(denied.failed_login) << "nothing was tried";
}

TEST_F(GateTest, CachedTokenEndsWithItsTimeAndKey) {
  const std::string token = token_for("viewer", {}, {"lab/**"});
  const auto request = request_from("8.8.8.8", token);
  const auto status_at = [&](std::int64_t now_s) {
    const auto admitted = gate().admit(request, 0, now_s);
    const auto* denied = std::get_if<Denial>(&admitted);
    return denied == nullptr ? 0 : denied->status;
  };
  EXPECT_TRUE(let_in(request)->may_subscribe("lab/a"));
  const GrantPtr again = let_in(request);
  EXPECT_TRUE(again->may_subscribe("lab/a"));
  EXPECT_FALSE(again->may_subscribe("other"));
  EXPECT_FALSE(again->may_publish("lab/a"));
  EXPECT_EQ(status_at(kNow + 59), 0);
  EXPECT_EQ(status_at(kNow + 60 + config_.access.jwt_leeway_s), 401);
  std::string forged = token;
  forged.back() = forged.back() == 'A' ? 'B' : 'A';
  EXPECT_EQ(turned_away(request_from("8.8.8.8", forged)).status, 401);
  EXPECT_TRUE(let_in(request));
  config_.access.jwt_secret = "another secret of the tests, long enough";
  reload();
  EXPECT_EQ(turned_away(request).status, 401);
}

TEST(TokenCacheTest, IsBoundedAndChecksTimes) {
  TokenCache cache;
  Claims claims;
  claims.expires_s = 100;
  claims.not_before_s = 50;
  const auto hash = [](std::uint64_t i) {
    Bytes bytes;
    ByteWriter(bytes).u64(i);
    return sha256(bytes);
  };
  cache.keep(hash(0), claims);
  EXPECT_TRUE(cache.find(hash(0), 5, 45));
  EXPECT_TRUE(cache.find(hash(0), 5, 104));
  EXPECT_FALSE(cache.find(hash(1), 5, 60));
  EXPECT_FALSE(cache.find(hash(0), 5, 44)) << "the clock was set back";
  EXPECT_FALSE(cache.find(hash(0), 5, 60)) << "what was refused once is forgotten";
  for (std::uint64_t i = 0; i < TokenCache::kMaxTokens; ++i) cache.keep(hash(i), claims);
  EXPECT_TRUE(cache.find(hash(0), 5, 60));
  cache.keep(hash(TokenCache::kMaxTokens), claims);
  for (std::uint64_t i = 0; i < TokenCache::kMaxTokens; ++i) EXPECT_FALSE(cache.find(hash(i), 5, 60));
  EXPECT_TRUE(cache.find(hash(TokenCache::kMaxTokens), 5, 60));
  EXPECT_FALSE(cache.find(hash(TokenCache::kMaxTokens), 5, 105));
}

TEST_F(GateTest, ClaimedAddressIsNeverLocal) {
  config_.access.monitors = {"10.0.0.0/8", "127.0.0.1"};
  for (const bool trusted : {false, true}) {
    if (trusted) config_.proxy.trusted = {"127.0.0.1", "10.0.0.0/8"};
    gate_.reset();
    for (const char* peer : {"127.0.0.1", "10.1.2.3", "::1"}) {
      const auto with = [&](auto&& change) {
        auto request = request_from(peer);
        change(request.forwarded);
        EXPECT_EQ(turned_away(request).status, 401) << peer;
        EXPECT_TRUE(gate().admit_admin(request, Gate::AdminRequest::kRead, 0, kNow)) << peer;
      };
      with([](ForwardedHeaders& headers) { headers.x_forwarded_for = "127.0.0.1"; });
      with([](ForwardedHeaders& headers) { headers.x_forwarded_for = "10.1.2.4, 127.0.0.1"; });
      with([](ForwardedHeaders& headers) { headers.forwarded = "for=127.0.0.1"; });
      with([](ForwardedHeaders& headers) { headers.others = true; });
    }
  }
}

TEST_F(GateTest, ReboundNameIsNeitherLocalNorMonitor) {
  config_.access.monitors = {"10.0.0.0/8"};
  const auto read_as = [&](const char* peer, const char* host) {
    auto request = request_from(peer);
    request.host = host;
    return !gate().admit_admin(request, Gate::AdminRequest::kRead, 0, kNow);
  };
  for (const char* peer : {"127.0.0.1", "10.1.2.3"}) {
    for (const char* own : {"", "localhost", "localhost:7491", "127.0.0.1:7491", "10.9.9.9", "[::1]:7491"}) {
      EXPECT_TRUE(read_as(peer, own)) << own;
    }
    for (const char* foreign : {"evil.example", "evil.example:7491", "localhost.evil.example", "127.0.0.1.evil.example",
                                "[evil.example]:7491", ":7491", "broker", "127.0.0.1%x.evil", "[::1%x.evil]",
                                "[::1].evil.example", "[::1", "127.0.0.1:x", "user@127.0.0.1"}) {
      EXPECT_FALSE(read_as(peer, foreign)) << foreign;
    }
  }
  auto request = request_from("127.0.0.1");
  request.host = "evil.example:7490";
  EXPECT_EQ(turned_away(request).status, 401);
  config_.access.hosts = {"broker"};
  reload();
  for (const char* own : {"broker:7491", "Broker:7491", "BROKER.", "localhost.", "LOCALHOST:7491"}) {
    EXPECT_TRUE(read_as("10.1.2.3", own)) << own;
  }
  EXPECT_FALSE(read_as("10.1.2.3", "broker.."));
  EXPECT_FALSE(read_as("10.1.2.3", "brokers"));
}

TEST_F(GateTest, ListedPagesDoNotOpenTheAdminPort) {
  config_ = {};
  config_.access.origins = {"https://viewer.example", "*"};
  auto page = request_from("127.0.0.1");
  page.origin = "https://viewer.example";
  EXPECT_TRUE(let_in(page));
  for (const auto ask : {Gate::AdminRequest::kRead, Gate::AdminRequest::kControl}) {
    EXPECT_TRUE(gate().admit_admin(page, ask, 0, kNow));
  }
}

TEST_F(GateTest, AnonymousRightsFollowConfiguration) {
  config_.access.anonymous = "anywhere";
  config_.access.anonymous_publish = {};
  config_.access.anonymous_subscribe = {"public/**"};
  const auto grant = let_in(request_from("8.8.8.8"));
  EXPECT_FALSE(grant->may_publish("public/a"));
  EXPECT_TRUE(grant->may_subscribe("public/a"));
  EXPECT_THAT(grant->may_subscribe("private").error().message, HasSubstr("'public/**'"));
  EXPECT_FALSE(grant->may_store_assets());
  EXPECT_TRUE(grant->may_fetch_assets());
  EXPECT_TRUE(grant->may_see("public/a"));
  EXPECT_FALSE(grant->may_see("private"));
  config_.access.anonymous = "nowhere";
  gate_.reset();
  EXPECT_EQ(turned_away(request_from("127.0.0.1")).status, 401);
}

TEST_F(GateTest, TokenGrantsRightsFromAnyAddress) {
  const auto grant = let_in(request_from("8.8.8.8", token_for("camera-1", {"lab/**"}, {})));
  EXPECT_EQ(grant->label(), "token 'camera-1' from 8.8.8.8");
  EXPECT_TRUE(grant->may_publish("lab/horse"));
  EXPECT_EQ(grant->may_subscribe("lab/horse").error().code, ErrorCode::kRefused);
  auto in_query = request_from("8.8.8.8");
  in_query.query_token = token_for("viewer", {}, {"**"});
  EXPECT_TRUE(let_in(in_query)->may_subscribe("a"));
  in_query.authorization = "Bearer x";
  EXPECT_EQ(turned_away(in_query).status, 400);
}

TEST_F(GateTest, WrongTokenIsNotAnonymous) {
  for (const char* header : {"Bearer ", "Bearer x", "Bearer a.b.c", "Basic dTpw", "Bearer", "x"}) {
    auto request = request_from("127.0.0.1");
    request.authorization = header;
    const Denial denied = turned_away(request, kSecond * 100'000);
    EXPECT_EQ(denied.status, 401) << header;
    EXPECT_TRUE(denied.failed_login) << header;
  }
}

TEST_F(GateTest, FailuresThrottleOnlyTheirAddress) {
  config_.access.failures_per_minute = 6;
  const auto wrong = request_from("8.8.8.8", "a.b.c");
  for (int i = 0; i < 6; ++i) EXPECT_EQ(turned_away(wrong).status, 401);
  const Denial slowed = turned_away(wrong);
  EXPECT_EQ(slowed.status, 429);
  EXPECT_EQ(slowed.retry_after_s, 11);
  const std::string good = token_for("a", {}, {"**"});
  EXPECT_TRUE(let_in(request_from("8.8.8.8", good))) << "others' failures lock nobody out";
  EXPECT_TRUE(let_in(request_from("8.8.8.9", good)));
  for (int i = 0; i < 6; ++i) EXPECT_EQ(turned_away(request_from("2001:db8:1:1::1", "a.b.c")).status, 401);
  EXPECT_EQ(turned_away(request_from("2001:db8:1:1::2", "a.b.c")).status, 429);
  EXPECT_EQ(turned_away(request_from("2001:db8:1:2::1", "a.b.c")).status, 401) << "a neighbour of the same site";
  EXPECT_EQ(turned_away(wrong, 11 * kSecond).status, 401);
  EXPECT_EQ(turned_away(wrong, 11 * kSecond).status, 429);
}

TEST_F(GateTest, ChecksOfTokensArePaidByTheirAddress) {
  config_.access.failures_per_minute = 1;
  config_.per_address.work_us_per_s = 100'000;  // 2,000 us at once.
  const auto wrong = request_from("8.8.8.8", "a.b.c");
  EXPECT_EQ(turned_away(wrong).status, 401);
  for (int i = 0; i < 8; ++i) EXPECT_EQ(turned_away(wrong).status, 429);
  const std::string good = token_for("a", {}, {"**"});
  EXPECT_TRUE(let_in(request_from("8.8.8.8", good)));
  EXPECT_EQ(turned_away(wrong).status, 429) << "all is spent";
  EXPECT_TRUE(let_in(request_from("8.8.8.8", good))) << "it is known";
  const std::string another = token_for("b", {}, {"**"});
  EXPECT_EQ(turned_away(request_from("8.8.8.8", another)).status, 429);
  EXPECT_TRUE(let_in(request_from("8.8.8.9", another)));
  EXPECT_TRUE(let_in(request_from("8.8.8.8", token_for("c", {}, {"**"})), kSecond));
}

/// A site has 65,536 networks, each of which may fail some times a minute.
TEST_F(GateTest, ChecksOfTokensArePaidByTheirSiteFromTheFirstOn) {
  config_.per_address.work_us_per_s = 100'000;  // 2,000 us at once.
  const auto network = [](int i) { return request_from(("2001:db8:1:" + std::to_string(i) + "::1").c_str(), "a.b.c"); };
  for (int i = 0; i < 10; ++i) EXPECT_EQ(turned_away(network(i)).status, 401);
  EXPECT_EQ(turned_away(network(10)).status, 429);
  EXPECT_EQ(turned_away(request_from("2001:db8:2::1", "a.b.c")).status, 401);
  EXPECT_EQ(gate().check_us(network(10), kNow), 200);
  EXPECT_EQ(turned_away(network(11)).status, 429);
  auto paid = gate().admit(network(11), 0, kNow, true);
  EXPECT_EQ(std::get<Denial>(paid).status, 401) << "before its turn came";
}

TEST_F(GateTest, FailuresOfASiteAreTenTimesThoseOfOneNetwork) {
  config_.access.failures_per_minute = 1;
  const auto network = [](int i) { return request_from(("2001:db8:1:" + std::to_string(i) + "::1").c_str(), "a.b.c"); };
  for (int i = 0; i < 10; ++i) EXPECT_EQ(turned_away(network(i)).status, 401);
  EXPECT_EQ(turned_away(network(10)).status, 429);
  EXPECT_EQ(turned_away(request_from("2001:db8:2::1", "a.b.c")).status, 401);
  EXPECT_TRUE(let_in(request_from("2001:db8:1:b::1", token_for("a", {}, {"**"}))));
}

TEST_F(GateTest, NetworksOfASiteShareItsStreamsAndTime) {
  config_.access.anonymous = "anywhere";
  config_.per_address.sent_streams = 3;
  const auto first = let_in(request_from("2001:db8:1:1::1")), second = let_in(request_from("2001:db8:1:2::1"));
  std::vector<std::shared_ptr<void>> held;
  for (int i = 0; i < 3; ++i) held.push_back((i == 0 ? first : second)->hold(Resource::kSentStream).value());
  EXPECT_FALSE(first->hold(Resource::kSentStream));
  EXPECT_FALSE(second->hold(Resource::kSentStream));
  EXPECT_TRUE(let_in(request_from("2001:db8:2::1"))->hold(Resource::kSentStream));
  held.clear();
  EXPECT_TRUE(first->hold(Resource::kSentStream));
  EXPECT_EQ(first->take_http_work(100'000, kSecond, kSecond), 0);
  EXPECT_GT(second->take_http_work(100, kSecond, kSecond).value(), 0);
  EXPECT_EQ(let_in(request_from("2001:db8:2::1"))->take_http_work(100, kSecond, kSecond), 0);
}

TEST_F(GateTest, ExpiredTokenEndsConnectionsIfConfigured) {
  const auto grant = let_in(request_from("8.8.8.8", token_for("a", {}, {"**"}, false, kNow + 60)));
  EXPECT_FALSE(grant->has_expired(kNow + 89)) << "the leeway counts";
  EXPECT_TRUE(grant->has_expired(kNow + 90));
  config_.access.expiry_disconnects = false;
  reload();
  EXPECT_FALSE(grant->is_void());
  EXPECT_FALSE(grant->has_expired(kNow + 90));
  EXPECT_FALSE(let_in(request_from("127.0.0.1"))->has_expired(kNow * 2));
}

TEST_F(GateTest, ResourcesAreLimitedPerAddressAndToken) {
  config_.per_address.connections = 3;
  config_.per_token.connections = 2;
  const std::string token = token_for("a", {"x"}, {"**"});
  auto first = let_in(request_from("1.1.1.1", token));
  EXPECT_TRUE(first->take(Resource::kConnection));
  auto second = let_in(request_from("2.2.2.2", token));
  EXPECT_TRUE(second->take(Resource::kConnection));
  auto third = let_in(request_from("1.1.1.1", token));
  EXPECT_THAT(third->take(Resource::kConnection).error().message, HasSubstr("per_token.connections = 2"));
  const auto other = let_in(request_from("1.1.1.1", token_for("b", {}, {"**"})));
  EXPECT_TRUE(other->take(Resource::kConnection));
  EXPECT_TRUE(other->take(Resource::kConnection)) << "what the token refused was not counted to the address";
  EXPECT_THAT(other->take(Resource::kStream), ::testing::Truly([](const auto& r) { return r.has_value(); }));
  const auto anonymous = let_in(request_from("127.0.0.1"));
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(anonymous->take(Resource::kConnection));
  EXPECT_THAT(anonymous->take(Resource::kConnection).error().message, HasSubstr("per_address.connections = 3"));
  second.reset();
  EXPECT_FALSE(third->take(Resource::kConnection)) << "the address is full now";
  first.reset();
  EXPECT_TRUE(third->take(Resource::kConnection));
  third->give_back(Resource::kConnection);
  EXPECT_TRUE(third->take(Resource::kConnection));
}

/// Fills places from one peer, until it gets no more, while `others` are open besides.
std::vector<GrantPtr> hoard(Gate& gate, const char* peer, std::int64_t others = 0) {
  std::vector<GrantPtr> all;
  for (;;) {
    auto accepted = gate.accept(IpAddress::from_text(peer).value(), others + std::ssize(all), 0);
    auto* grant = std::get_if<GrantPtr>(&accepted);
    if (grant == nullptr) return all;
    all.push_back(std::move(*grant));
  }
}

TEST_F(GateTest, ConnectionsCountBeforeReading) {
  config_.per_address.connections = 1;
  config_.proxy.trusted = {"10.0.0.1"};
  auto grants = hoard(gate(), "8.8.8.8");
  EXPECT_EQ(grants.size(), 1u);
  EXPECT_EQ(std::get<Denial>(gate().accept(IpAddress::from_text("8.8.8.8").value(), 1, 0)).status, 429);
  grants.clear();
  EXPECT_EQ(hoard(gate(), "8.8.8.8").size(), 1u);
}

TEST_F(GateTest, OneAddressLeavesPlacesOfConnectionsToOthers) {
  config_.limits.max_connections = 200;
  config_.proxy.trusted = {"10.0.0.1"};
  const auto greedy = hoard(gate(), "8.8.8.8");
  EXPECT_EQ(greedy.size(), 40u) << "a quarter of the other 160";
  const auto second = hoard(gate(), "9.9.9.9", 40);
  EXPECT_EQ(second.size(), 32u);
  EXPECT_EQ(hoard(gate(), "2001:db8::1", 199).size(), 1u) << "a newcomer, as long as there is room";
  const auto network = hoard(gate(), "2001:db8:5:1::1", 72);
  EXPECT_EQ(network.size(), 25u);
  EXPECT_EQ(hoard(gate(), "2001:db8:5:2::1", 97).size(), 0u) << "another of its site";
  EXPECT_EQ(std::get<Denial>(gate().accept(IpAddress::from_text("1.1.1.1").value(), 200, 0)).status, 503);
  EXPECT_EQ(hoard(gate(), "127.0.0.1").size(), 188u) << "this machine leaves a sixteenth";
  EXPECT_EQ(hoard(gate(), "10.0.0.1").size(), 200u) << "a proxy carries many";
  config_.access.anonymous = "nowhere";
  reload();
  EXPECT_EQ(hoard(gate(), "127.0.0.1").size(), 40u) << "where strangers may be";
}

TEST_F(GateTest, PlaceOfAConnectionPassesToItsClient) {
  config_.limits.max_connections = 20;
  config_.proxy.trusted = {"10.0.0.1"};
  auto through_proxy = request_from("10.0.0.1", token_for("a", {"**"}, {}));
  through_proxy.forwarded.x_forwarded_for = "127.0.0.1";
  const auto proxy = std::get<GrantPtr>(gate().accept(through_proxy.peer, 0, 0));
  std::vector<GrantPtr> clients;
  for (int i = 0; i < 4; ++i) {
    clients.push_back(let_in(through_proxy));
    EXPECT_TRUE(clients.back()->take_place(i, proxy.get()));
    EXPECT_FALSE(clients.back()->is_spared()) << "whatever address it claims";
  }
  EXPECT_EQ(let_in(through_proxy)->take_place(4, proxy.get()).error().code, ErrorCode::kRefused);

  auto peers = hoard(gate(), "8.8.8.8", 4);
  ASSERT_EQ(peers.size(), 3u);
  const auto as_a = let_in(request_from("8.8.8.8", token_for("a", {"**"}, {})));
  EXPECT_FALSE(as_a->take_place(6, peers[0].get())) << "the token has its share";
  EXPECT_EQ(hoard(gate(), "8.8.8.8", 7).size(), 0u) << "the connection still counts to its address";
  const auto as_b = let_in(request_from("8.8.8.8", token_for("b", {"**"}, {})));
  EXPECT_TRUE(as_b->take_place(6, peers[0].get()));
  peers.clear();
  clients.clear();
  EXPECT_EQ(hoard(gate(), "8.8.8.8", 1).size(), 3u) << "beside that of the token";
}

TEST_F(GateTest, MessagesAndUploadsAreRateLimited) {
  config_.per_address.messages_per_s = 10;
  config_.per_address.upload_bytes_per_hour = 3600;
  const auto grant = let_in(request_from("127.0.0.1"));
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(grant->take_message(0)) << i;
  EXPECT_FALSE(grant->take_message(0));
  EXPECT_TRUE(grant->take_message(100'000));
  EXPECT_FALSE(grant->take_message(100'000));
  EXPECT_TRUE(let_in(request_from("127.0.0.2"))->take_message(100'000));
  EXPECT_TRUE(grant->take_upload(3600, 0));
  EXPECT_THAT(grant->take_upload(1, 0).error().message, HasSubstr("upload_bytes_per_hour"));
  EXPECT_TRUE(grant->take_upload(10, 10 * kSecond));
  config_.per_token.download_bytes_per_hour = 7200;
  reload();
  const auto reader = let_in(request_from("8.8.8.8", token_for("a", {}, {"**"})));
  EXPECT_TRUE(reader->take_download(7200, 0));
  EXPECT_THAT(reader->take_download(1, 0).error().message, HasSubstr("per_token.download_bytes_per_hour = 7200"));
  EXPECT_TRUE(reader->take_upload(1, 0)) << "each direction for itself";
  EXPECT_TRUE(reader->take_download(20, 10 * kSecond));
}

TEST_F(GateTest, UploadsAreCountedPerHolder) {
  config_.per_address.uploads = 2;
  config_.per_token.uploads = 1;
  const std::string token = token_for("a", {"**"}, {});
  const auto one = let_in(request_from("8.8.8.8", token));
  EXPECT_TRUE(one->take(Resource::kUpload));
  const auto same_token = let_in(request_from("9.9.9.9", token));
  EXPECT_THAT(same_token->take(Resource::kUpload).error().message, HasSubstr("per_token.uploads = 1"));
  const auto same_address = let_in(request_from("8.8.8.8", token_for("b", {"**"}, {})));
  EXPECT_TRUE(same_address->take(Resource::kUpload));
  const auto third = let_in(request_from("8.8.8.8", token_for("c", {"**"}, {})));
  EXPECT_THAT(third->take(Resource::kUpload).error().message, HasSubstr("per_address.uploads = 2"));
  one->give_back(Resource::kUpload);
  EXPECT_TRUE(third->take(Resource::kUpload));
  EXPECT_TRUE(same_token->take(Resource::kUpload));
}

TEST_F(GateTest, ReloadRevokesGrants) {
  const auto signed_one = let_in(request_from("8.8.8.8", token_for("a", {}, {"**"})));
  const auto local = let_in(request_from("127.0.0.1"));
  reload();
  EXPECT_FALSE(signed_one->is_void()) << "nothing has changed";
  EXPECT_FALSE(local->is_void());
  config_.access.anonymous = "anywhere";
  reload();
  const auto remote = let_in(request_from("9.9.9.9"));
  EXPECT_FALSE(local->is_void() || remote->is_void() || signed_one->is_void());
  config_.access.anonymous = "loopback";
  reload();
  EXPECT_TRUE(remote->is_void());
  EXPECT_FALSE(local->is_void());
  config_.access.anonymous_publish = {"lab/**"};
  reload();
  EXPECT_TRUE(local->is_void()) << "other rights than it was let in with";
  EXPECT_FALSE(signed_one->is_void());
  config_.access.jwt_secret = "another secret of at least 32 bytes";
  reload();
  EXPECT_TRUE(signed_one->is_void()) << "the key has changed";
}

TEST_F(GateTest, ReloadEndsPagesNoLongerListed) {
  config_.access.anonymous = "anywhere";
  config_.access.origins = {"https://viewer.example", "https://*.lab.example"};
  const auto page = [&](const std::string& origin, const std::string& token = {}) {
    auto request = request_from("8.8.8.8", token);
    request.origin = origin;
    return let_in(request);
  };
  const auto anonymous = page("https://viewer.example");
  const auto with_token = page("https://viewer.example", token_for("a", {}, {"**"}));
  const auto other = page("https://a.lab.example");
  const auto own = page("http://127.0.0.1:7490");
  reload();
  EXPECT_FALSE(anonymous->is_void() || with_token->is_void() || other->is_void() || own->is_void());
  config_.access.origins = {"https://*.lab.example"};
  reload();
  EXPECT_TRUE(anonymous->is_void());
  EXPECT_TRUE(with_token->is_void());
  EXPECT_FALSE(other->is_void());
  EXPECT_FALSE(own->is_void()) << "a page of the broker's host needs no listing";
}

TEST_F(GateTest, StrangersOfAProxyPayForThemselves) {
  config_.proxy.trusted = {"10.0.0.1"};
  config_.per_address.requests_per_s = 1;
  const auto pays = [&](const char* peer, const char* client) {
    auto request = request_from(peer);
    request.forwarded.x_forwarded_for = client;
    return gate().stranger(request, 0)->take_request(0, 0, 0).has_value();
  };
  EXPECT_TRUE(pays("10.0.0.1", "1.1.1.1"));
  EXPECT_FALSE(pays("10.0.0.1", "1.1.1.1"));
  EXPECT_TRUE(pays("10.0.0.1", "2.2.2.2"));
  EXPECT_TRUE(pays("8.8.8.8", "3.3.3.3"));
  EXPECT_FALSE(pays("8.8.8.8", "4.4.4.4")) << "a claim of a stranger counts for nothing";
}

TEST_F(GateTest, WhomAProxyDoesNotNamePaysAsOneClient) {
  config_.proxy.trusted = {"10.0.0.1"};
  config_.per_address.work_us_per_s = 1'000;
  const auto wait_us = [&](const char* client) {
    auto request = request_from("10.0.0.1");
    request.forwarded.x_forwarded_for = client;
    return gate().stranger(request, kSecond)->take_http_work(1'000, kSecond, kSecond - 1);
  };
  EXPECT_EQ(wait_us(""), 0);
  for (const char* unnamed : {"", "nobody", "1.1.1.1, nobody", "10.0.0.1"}) EXPECT_EQ(wait_us(unnamed), std::nullopt);
  EXPECT_EQ(wait_us("1.1.1.1"), 0);
}

TEST_F(GateTest, ReloadedLimitsApplyToExistingGrants) {
  const auto grant = let_in(request_from("127.0.0.1"));
  EXPECT_TRUE(grant->take(Resource::kStream));
  config_.per_address.streams = 1;
  reload();
  EXPECT_FALSE(grant->is_void());
  EXPECT_THAT(grant->take(Resource::kStream).error().message, HasSubstr("per_address.streams = 1"));
}

TEST_F(GateTest, FixedTokenEndsWithItsLine) {
  const std::string path = ::testing::TempDir() + "/eigencast-gate-tokens";
  const auto made = create_static_token("cam", {"lab/**"}, {}, false).value();
  const auto write = [&](const std::string& text) {
    std::ofstream(path) << text << "\n";
    ::chmod(path.c_str(), 0600);
    config_.access.tokens_file = path;
    if (gate_) reload();
  };
  write(made.line);
  const auto grant = let_in(request_from("8.8.8.8", made.token));
  write("# moved\n" + made.line);
  EXPECT_FALSE(grant->is_void());
  write(made.line + " sub=**");
  EXPECT_TRUE(grant->is_void()) << "it has other rights now";
  const auto again = let_in(request_from("8.8.8.8", made.token));
  write("# taken out");
  EXPECT_TRUE(again->is_void());
  EXPECT_EQ(turned_away(request_from("8.8.8.8", made.token)).status, 401);
  std::remove(path.c_str());
}

TEST_F(GateTest, ForeignOriginsAreRefused) {
  config_.access.anonymous = "anywhere";
  config_.access.origins = {"https://viewer.example", "https://*.lab.example"};
  const auto with = [&](const std::string& origin, const char* peer = "8.8.8.8") {
    auto request = request_from(peer);
    request.host = "broker.example:7490";
    request.origin = origin;
    auto admitted = gate().admit(request, 0, kNow);
    return std::holds_alternative<GrantPtr>(admitted);
  };
  EXPECT_TRUE(with(""));
  EXPECT_TRUE(with("https://broker.example:7490"));
  EXPECT_TRUE(with("https://viewer.example"));
  EXPECT_TRUE(with("https://a.lab.example"));
  for (const char* bad :
       {"https://evil.example", "https://viewer.example.evil", "http://viewer.example", "null", "https://lab.example",
        "https://.lab.example", "https://x/.lab.example", "https://broker.example"}) {
    EXPECT_FALSE(with(bad)) << bad;
  }
}

TEST_F(GateTest, LocalBrowserOnForeignPageIsNotLocal) {
  auto request = request_from("127.0.0.1");
  request.host = "evil.example:7490";
  request.origin = "http://evil.example:7490";  // A name that its owner lets resolve to 127.0.0.1.
  EXPECT_EQ(turned_away(request).status, 401);
  request.host = "localhost:7490";
  request.origin = "http://localhost:7490";
  EXPECT_TRUE(let_in(request));
}

TEST_F(GateTest, ReboundPagesAreLetInNowhere) {
  config_.access.anonymous = "anywhere";
  config_.access.hosts = {"broker.lan"};
  config_.access.origins = {"http://viewer.example"};
  config_.proxy.trusted = {"10.0.0.1"};
  auto page = request_from("10.1.2.3");
  const auto opens = [&](const std::string& scheme, const std::string& host) {
    page.host = host;
    page.origin = scheme + host;
    return std::holds_alternative<GrantPtr>(gate().admit(page, 0, kNow));
  };
  for (const char* peer : {"10.1.2.3", "127.0.0.1"}) {
    page.peer = *IpAddress::from_text(peer);
    EXPECT_FALSE(opens("http://", "evil.example:7490")) << peer;
    EXPECT_THAT(turned_away(page).message, HasSubstr("access.hosts"));
    EXPECT_FALSE(opens("http://", "evil.example/:7490")) << peer;
    for (const char* own : {"10.9.9.9:7490", "[fd00::1]:7490", "localhost:7490", "broker.lan:7490", "viewer.example"})
      EXPECT_TRUE(opens("http://", own)) << peer << own;
    EXPECT_TRUE(opens("https://", "broker.example")) << "its certificate says so";
    char name[256] = {};
    ASSERT_EQ(::gethostname(name, sizeof name - 1), 0);
    EXPECT_TRUE(opens("http://", std::string(name) + ":7490")) << name;
  }
  page.peer = *IpAddress::from_text("10.0.0.1");
  EXPECT_TRUE(opens("http://", "broker.example")) << "the proxy knows its names";
  auto program = request_from("10.1.2.3");
  program.host = "broker.example:7490";
  EXPECT_TRUE(let_in(program)) << "no page";
}

TEST_F(GateTest, AdminPortRequiresAdminRight) {
  const auto denied = [&](const AccessRequest& request, Gate::AdminRequest ask) {
    const auto found = gate().admit_admin(request, ask, 0, kNow);
    return found ? found->status : 0;
  };
  using Ask = Gate::AdminRequest;
  EXPECT_EQ(denied(request_from("127.0.0.1"), Ask::kRead), 0);
  EXPECT_EQ(denied(request_from("127.0.0.1"), Ask::kControl), 401) << "tokens are configured";
  EXPECT_EQ(denied(request_from("8.8.8.8"), Ask::kRead), 401);
  EXPECT_EQ(denied(request_from("8.8.8.8", token_for("a", {"**"}, {"**"})), Ask::kRead), 403);
  EXPECT_EQ(denied(request_from("8.8.8.8", token_for("a", {}, {}, true)), Ask::kControl), 0);
  config_.access.anonymous = "anywhere";
  gate_.reset();
  EXPECT_EQ(denied(request_from("8.8.8.8"), Ask::kRead), 401) << "anonymous is never admin";
  config_ = {};
  gate_.reset();
  EXPECT_EQ(denied(request_from("127.0.0.1"), Ask::kControl), 0);
  auto page = request_from("127.0.0.1");
  page.origin = "https://evil.example";
  EXPECT_NE(denied(page, Ask::kControl), 0);
}

TEST_F(GateTest, MonitorsMayOnlyReadAdminPort) {
  config_.access.monitors = {"10.88.0.0/16"};
  config_.proxy.trusted = {"10.88.0.1"};
  const auto denied = [&](const AccessRequest& request, Gate::AdminRequest ask) {
    const auto found = gate().admit_admin(request, ask, 0, kNow);
    return found ? found->status : 0;
  };
  using Ask = Gate::AdminRequest;
  EXPECT_EQ(denied(request_from("10.88.0.7"), Ask::kRead), 0);
  EXPECT_EQ(denied(request_from("10.88.0.7"), Ask::kControl), 401);
  EXPECT_EQ(denied(request_from("10.89.0.7"), Ask::kRead), 401);
  auto page = request_from("10.88.0.7");
  page.origin = "http://broker.example:7490";
  EXPECT_NE(denied(page, Ask::kRead), 0) << "a page in a browser there";
  auto forwarded = request_from("10.88.0.1");
  forwarded.forwarded.x_forwarded_for = "8.8.8.8";
  EXPECT_EQ(denied(forwarded, Ask::kRead), 401) << "the proxy is a monitor, those behind it are not";
  auto claimed = request_from("10.88.0.7");
  claimed.forwarded.x_forwarded_for = "10.88.0.8";
  EXPECT_EQ(denied(claimed, Ask::kRead), 401);
}

TEST(LedgerTest, IsBoundedAndStricterWhenFull) {
  Ledger ledger(2);
  const auto a = ledger.account("a", 0);
  const auto b = ledger.account("b", 0);
  EXPECT_TRUE(b->resources[0].take(1));
  const auto c = ledger.account("c", 0);
  EXPECT_EQ(c, ledger.account("d", 0)) << "both resource one";
  EXPECT_NE(c, a);
  EXPECT_EQ(ledger.account("a", 0), a);
  EXPECT_EQ(ledger.account("b", 0), b);
}

TEST(LedgerTest, KeepsAccountsInUse) {
  Ledger ledger(2);
  EXPECT_TRUE(ledger.account("mark_dirty", 0)->failures.take(1, 0.01, 1, 0));
  (void)ledger.account("idle", 0);
  const auto fresh = ledger.account("fresh", 10 * kSecond);
  EXPECT_EQ(fresh, ledger.account("fresh", 10 * kSecond)) << "the idle one made room";
  EXPECT_FALSE(ledger.account("mark_dirty", 10 * kSecond)->failures.take(1, 0.01, 1, 10 * kSecond))
      << "not a new account";
}

TEST(LedgerTest, ForgetsTheLeastRecentlyUsedOneForEachNewcomer) {
  constexpr std::size_t kAccounts = 1000;
  Ledger ledger(kAccounts);
  const auto fails = [&](std::size_t i, TimeUs now_us) {
    return ledger.account(std::to_string(i), now_us)->failures.take(1, 0.001, 1, now_us).has_value();
  };
  for (std::size_t i = 0; i < kAccounts; ++i) EXPECT_TRUE(fails(i, 0));
  EXPECT_FALSE(fails(0, 1));
  EXPECT_TRUE(fails(kAccounts, 2 * kSecond)) << "a newcomer";
  for (std::size_t i = 2; i < kAccounts; ++i) EXPECT_FALSE(fails(i, 2 * kSecond)) << i;
  EXPECT_FALSE(fails(0, 2 * kSecond));
  EXPECT_TRUE(fails(1, 2 * kSecond)) << "the one used longest ago";
}

TEST(LedgerTest, ManyAddressesSpendNoRatesOfNewcomers) {
  Ledger ledger(4);
  const auto held = ledger.account("held", 0);
  EXPECT_TRUE(held->resources[0].take(1));
  const auto fails = [&](const std::string& key, TimeUs now_us) {
    return ledger.account(key, now_us)->failures.take(1, 0.001, 1, now_us).has_value();
  };
  for (int i = 0; i < 100; ++i) (void)fails("guesses " + std::to_string(i), i);
  EXPECT_TRUE(fails("newcomer", 2 * kSecond));
  EXPECT_FALSE(fails("newcomer", 2 * kSecond));
  EXPECT_EQ(ledger.account("held", 2 * kSecond), held);
}

TEST(LedgerTest, LimitsHoldAcrossThreads) {
  constexpr int kThreads = 4, kTries = 2000, kMaxTokens = 3000;
  Ledger ledger;
  std::atomic<int> admitted{0}, messages{0};
  {
    std::vector<std::jthread> threads;
    for (int i = 0; i < kThreads; ++i) {
      threads.emplace_back([&] {
        const auto account = ledger.account("one", 0);
        for (int k = 0; k < kTries; ++k) {
          if (account->resources[0].take(kMaxTokens)) ++admitted;
          if (account->messages.take(1, 0.001, kMaxTokens, 0)) ++messages;
        }
      });
    }
  }
  EXPECT_EQ(admitted, kMaxTokens);
  EXPECT_EQ(messages, kMaxTokens);
}

TEST(RateLimiterTest, NeverExceedsRateTimesTimePlusBurst) {
  RateLimiter pace;
  double taken = 0;
  for (TimeUs now = 0; now <= 10 * kSecond; now += 1000) {
    while (pace.take(3, 100, 20, now)) taken += 3;
    EXPECT_LE(taken, 100 * static_cast<double>(now) / 1e6 + 20 + 1e-6);
  }
  EXPECT_GE(taken, 100 * 10 + 20 - 3) << "and no less";
  EXPECT_GT(pace.wait_us(3, 100, 20, 10 * kSecond), 0);
  const TimeUs wait = pace.wait_us(20, 100, 20, 10 * kSecond);
  EXPECT_FALSE(pace.take(20, 100, 20, 10 * kSecond + wait - 10));
  EXPECT_TRUE(pace.take(20, 100, 20, 10 * kSecond + wait));
}

TEST_F(GateTest, RequestsWaitAndAreThenRefused) {
  config_.per_token.requests_per_s = 10;
  const auto grant = let_in(request_from("1.1.1.1", token_for("a", {}, {"**"})));
  const auto take = [&](TimeUs now_us) { return grant->take_request(0, now_us, 2 * kSecond); };
  for (int i = 0; i < 10; ++i) EXPECT_EQ(take(kSecond).value(), 0) << "at once";
  for (int i = 1; i <= 20; ++i) EXPECT_EQ(take(kSecond).value(), i * kSecond / 10);
  const auto refused = take(kSecond);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kRefused);
  EXPECT_THAT(refused.error().message, HasSubstr("per_token.requests_per_s = 10"));
  const auto neighbour = let_in(request_from("1.1.1.1", token_for("b", {}, {"**"})));
  EXPECT_EQ(neighbour->take_request(0, kSecond, 0).value(), 0) << "at the same address";
  EXPECT_EQ(let_in(request_from("127.0.0.1"))->take_request(0, kSecond, 0).value(), 0) << "others go on";
  EXPECT_EQ(take(4 * kSecond).value(), 0);
}

TEST_F(GateTest, ListsDelayNoOtherRequests) {
  config_.access.anonymous = "anywhere";
  config_.per_address.requests_per_s = 10;
  const auto flood = let_in(request_from("1.1.1.1")), neighbour = let_in(request_from("1.1.1.1"));
  EXPECT_EQ(flood->take_request(1000, 0, 5 * kSecond).value(), 0);
  const auto refused = flood->take_request(1000, 0, 5 * kSecond);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("per_address.requests_per_s = 10"));
  for (int i = 0; i < 9; ++i) EXPECT_EQ(neighbour->take_request(0, 0, 0).value(), 0) << i;
  EXPECT_FALSE(neighbour->take_request(1, 0, 5 * kSecond)) << "lists of an address wait for each other";
  EXPECT_EQ(let_in(request_from("1.1.1.2"))->take_request(1, 0, 0).value(), 0);
  EXPECT_EQ(flood->take_request(1000, 101 * kSecond, 5 * kSecond).value(), 0);
}

TEST_F(GateTest, WorkIsBudgetedPerHolder) {
  config_.per_token.work_us_per_s = 1'000'000;
  const auto request = request_from("1.1.1.1", token_for("a", {"**"}, {}));
  auto grant = let_in(request);
  EXPECT_EQ(grant->take_work(20'000, kSecond, 0), 0) << "at once";
  EXPECT_EQ(grant->take_work(20'000, kSecond, 0), std::nullopt);
  EXPECT_EQ(grant->take_work(20'000, kSecond, kSecond), 20'000);
  grant = let_in(request, kSecond);
  EXPECT_EQ(grant->take_work(20'000, kSecond, kSecond), 40'000) << "a new connection renews nothing";
  EXPECT_EQ(grant->take_work(0, kSecond, kSecond), 40'000) << "what was refused was not counted";
  EXPECT_EQ(grant->take_work(1, 3 * kSecond, 0), 0);
  const auto neighbour = let_in(request_from("1.1.1.1", token_for("b", {"**"}, {})), kSecond);
  EXPECT_EQ(neighbour->take_work(20'000, kSecond, 0), 0) << "at the same address";
  EXPECT_EQ(let_in(request_from("127.0.0.1"))->take_work(1, kSecond, 0), 0) << "others go on";
  EXPECT_EQ(neighbour->take_work(900'000, 3 * kSecond, 0), 0) << "more than comes at once, by one that is idle";
}

TEST_F(GateTest, PosesHaveABudgetOfTheirOwn) {
  config_.per_token.work_us_per_s = 1'000'000;
  const auto request = request_from("1.1.1.1", token_for("a", {"**"}, {}));
  const auto grant = let_in(request);
  EXPECT_TRUE(grant->charge_poses(0, kSecond));
  EXPECT_TRUE(grant->charge_poses(20'000, kSecond)) << "at once";
  EXPECT_FALSE(grant->charge_poses(20'000, kSecond)) << "made, and counted";
  EXPECT_FALSE(let_in(request)->charge_poses(0, kSecond + 10'000)) << "of another connection, too";
  EXPECT_TRUE(grant->charge_poses(0, kSecond + 20'000)) << "asking costs nothing";
  EXPECT_EQ(grant->take_work(20'000, kSecond, 0), 0) << "no message waits for poses";
  EXPECT_TRUE(let_in(request_from("1.1.1.1", token_for("b", {"**"}, {})))->charge_poses(0, kSecond));
}

TEST_F(GateTest, DeliveriesHaveABudgetOfTheirOwn) {
  config_.per_token.work_us_per_s = 1'000'000;
  const auto request = request_from("1.1.1.1", token_for("a", {"**"}, {}));
  const auto grant = let_in(request);
  EXPECT_EQ(grant->charge_deliveries(20'000, kSecond), 0) << "at once";
  (void)grant->charge_deliveries(3e6, kSecond);
  EXPECT_EQ(grant->charge_deliveries(0, kSecond), 3'000'000) << "they were written, and counted";
  EXPECT_EQ(let_in(request)->charge_deliveries(0, 2 * kSecond), 2'000'000) << "of another connection, too";
  EXPECT_EQ(grant->charge_deliveries(0, 5 * kSecond), 0);
  EXPECT_EQ(grant->take_work(20'000, kSecond, 0), 0) << "no message waits for them";
  EXPECT_EQ(let_in(request_from("1.1.1.1", token_for("b", {"**"}, {})))->charge_deliveries(1, kSecond), 0);
  const auto here = let_in(request_from("127.0.0.1"));
  EXPECT_EQ(here->charge_deliveries(1e9, kSecond), 0);
  EXPECT_EQ(here->charge_deliveries(1e9, kSecond), 0) << "this machine's have no limit";
}

TEST_F(GateTest, OneHolderLeavesUploadsToOthers) {
  config_.access.anonymous = "anywhere";
  const auto hog = let_in(request_from("1.1.1.1")), other = let_in(request_from("1.1.1.2"));
  std::int64_t used = 0;
  while (hog->take_share(Resource::kUpload, 16, used)) ++used;
  EXPECT_EQ(used, 3) << "a quarter of what is free";
  EXPECT_TRUE(other->take_share(Resource::kUpload, 16, used));
  hog->give_back(Resource::kUpload);
  EXPECT_TRUE(hog->take_share(Resource::kUpload, 16, used)) << "what was refused is not held";
}

TEST_F(GateTest, OneWhoHasALinkKeepsNobodyOutWhoHasItToo) {
  config_.per_token.requests_per_s = 10;
  config_.per_token.streams = 3;
  const std::string link = token_for("shared", {}, {"**"});
  std::vector<GrantPtr> hogs;
  do hogs.push_back(let_in(request_from("1.1.1.1", link)));
  while (hogs.back()->take_share(Resource::kConnection, 100, static_cast<std::int64_t>(hogs.size()) - 1));
  EXPECT_EQ(hogs.size(), 21) << "a fifth";
  (void)hogs[0]->take_work(1e6, kSecond, kForeverUs);
  const auto other = let_in(request_from("1.1.1.2", link));
  EXPECT_TRUE(other->take_share(Resource::kConnection, 100, 20));
  EXPECT_EQ(other->take_work(100, kSecond, 0), 0);
  EXPECT_NE(other->holder(), hogs[0]->holder());
  EXPECT_NE(other->purse(), hogs[0]->purse());
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(hogs[0]->take_request(0, kSecond, 0));
  EXPECT_FALSE(hogs[0]->take_request(0, kSecond, 0));
  EXPECT_TRUE(other->take_request(0, kSecond, 0));
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(hogs[0]->take(Resource::kStream));
  EXPECT_FALSE(hogs[1]->take(Resource::kStream));
  EXPECT_TRUE(other->take(Resource::kStream));
  hogs.clear();
  EXPECT_TRUE(let_in(request_from("1.1.1.1", link))->take_share(Resource::kConnection, 100, 1)) << "was given back";
  const std::string key = token_for("s", {"**"}, {});
  const auto sender = [&](const char* peer) { return let_in(request_from(peer, key))->holder(); };
  EXPECT_EQ(sender("1.1.1.1"), sender("1.1.1.2")) << "a sender may move";
}

TEST_F(GateTest, HttpIsBudgetedPerAddressBeforeAnyToken) {
  config_.per_address.work_us_per_s = 1'000;
  const auto accept = [&](const char* peer) {
    return std::get<GrantPtr>(gate().accept(IpAddress::from_text(peer).value(), 0, kSecond));
  };
  const auto wait_us = [&](const char* peer) { return accept(peer)->take_http_work(200, kSecond, kSecond); };
  EXPECT_EQ(wait_us("1.1.1.1"), 0);
  EXPECT_EQ(wait_us("1.1.1.1"), 200'000);
  for (int i = 0; i < 4; ++i) (void)wait_us("1.1.1.1");
  EXPECT_EQ(wait_us("1.1.1.1"), std::nullopt) << "too late";
  EXPECT_EQ(wait_us("1.1.1.2"), 0) << "another address";
  EXPECT_EQ(accept("1.1.1.1")->take_work(80, kSecond, 0), 0) << "newcomers delay no messages";
}

TEST_F(GateTest, UnfinishedBytesAreLimited) {
  config_.per_address.unfinished_bytes = 65'536;
  config_.per_token.unfinished_bytes = 70'000;
  config_.limits.max_unfinished_bytes = 400'000;
  const auto a = let_in(request_from("1.1.1.1", token_for("a", {}, {"**"})));
  const auto b = let_in(request_from("1.1.1.1", token_for("b", {}, {"**"})));
  const auto c = let_in(request_from("2.2.2.2", token_for("c", {}, {"**"})));
  const auto why = [](const Result<std::shared_ptr<void>>& held) { return held ? "held" : held.error().message; };
  auto first = a->hold_bytes(60'000);
  EXPECT_TRUE(first);
  EXPECT_THAT(why(a->hold_bytes(20'000)), HasSubstr("per_token.unfinished_bytes = 70000"));
  const auto second = b->hold_bytes(70'000);
  EXPECT_TRUE(second) << "a token at the same address, and what was refused was not counted";
  EXPECT_THAT(why(c->hold_bytes(69'000)), HasSubstr("limits.max_unfinished_bytes = 400000"));
  const auto third = c->hold_bytes(67'500);
  EXPECT_TRUE(third) << "a quarter of what is free";
  for (const auto& grant : {a, b, c}) {
    EXPECT_EQ(grant->hold_bytes(Grant::kFreeBytes).value(), nullptr) << "small ones go on";
  }
  first = std::shared_ptr<void>();
  EXPECT_TRUE(a->hold_bytes(60'000));
}

TEST_F(GateTest, WatchedStreamsAreSharedOverAllConnections) {
  config_.limits.max_watched_streams = 100;
  config_.per_token.streams = 50;
  const auto watch_all = [](const GrantPtr& grant) {
    int watched = 0;
    while (grant->take_watched_stream()) ++watched;
    return watched;
  };
  const auto a = let_in(request_from("1.1.1.1", token_for("a", {}, {"**"})));
  EXPECT_EQ(watch_all(a), 20) << "a quarter of what is free";
  EXPECT_EQ(watch_all(let_in(request_from("1.1.1.1", token_for("a", {}, {"**"})))), 0) << "on whatever connection";
  auto b = let_in(request_from("2.2.2.2", token_for("b", {}, {"**"})));
  EXPECT_EQ(watch_all(b), 16);
  EXPECT_THAT(b->take_watched_stream().error().message, HasSubstr("limits.max_watched_streams = 100"));
  b.reset();
  a->give_back(Resource::kStream);
  EXPECT_EQ(watch_all(a), 1) << "and what others gave back";
}

TEST_F(GateTest, HolderUsesUpFewEpochs) {
  const auto first = let_in(request_from("1.1.1.1", token_for("a", {"**"}, {})));
  for (double i = 0; i < Grant::kAnnouncementsPerHour; ++i) ASSERT_TRUE(first->take_announcement(false, kSecond));
  const auto again = let_in(request_from("2.2.2.2", token_for("a", {"**"}, {})));
  EXPECT_EQ(again->take_announcement(false, kSecond).error().code, ErrorCode::kRefused) << "whatever the connection";
  EXPECT_TRUE(let_in(request_from("1.1.1.1", token_for("b", {"**"}, {})))->take_announcement(false, kSecond));
  EXPECT_TRUE(again->take_announcement(false, 2 * kSecond)) << "more come with time";
  const auto inventor = let_in(request_from("1.1.1.1", token_for("c", {"**"}, {})));
  int names = 0;
  while (inventor->take_announcement(true, kSecond)) ++names;
  EXPECT_EQ(names, 1'000) << "of which all brokers keep rows";
  // All epochs last one that never stops for longer than the software does.
  EXPECT_GT(4e9 / (24 * Grant::kAnnouncementsPerHour), 10 * 365);
}

TEST_F(GateTest, CrowdsLeaveUnfinishedBytesToNewcomers) {
  config_.limits.max_unfinished_bytes = 256 << 20;
  std::vector<std::shared_ptr<void>> held;
  for (int i = 0; i < 10; ++i) {
    const std::string number = std::to_string(i);
    const auto greedy = let_in(request_from(("9.9.9." + number).c_str(), token_for("greedy" + number, {}, {"**"})));
    for (auto more = greedy->hold_bytes(48 << 10); more; more = greedy->hold_bytes(48 << 10)) held.push_back(*more);
  }
  const auto sender = let_in(request_from("2.2.2.2", token_for("sender", {}, {"**"})));
  EXPECT_TRUE(sender->hold_bytes(1 << 20));
}

TEST_F(GateTest, WhatStaysTakesNothingFromWhatComesAndGoes) {
  config_.limits.max_unfinished_bytes = 256 << 20;
  std::vector<std::shared_ptr<void>> held;
  std::vector<GrantPtr> senders;
  for (int i = 0; i < 8; ++i) {
    const std::string number = std::to_string(i);
    senders.push_back(let_in(request_from(("9.9.9." + number).c_str(), token_for("sends" + number, {"**"}, {}))));
    for (auto more = senders.back()->hold_wide(2 << 20); more; more = senders.back()->hold_wide(2 << 20))
      held.push_back(*more);
  }
  EXPECT_GT(held.size(), 16u);
  EXPECT_LE(held.size(), 64u) << "half of it";
  for (const GrantPtr& sender : senders) EXPECT_TRUE(sender->hold_bytes(1 << 20)) << "a frame that comes in two parts";
  held.clear();
  EXPECT_TRUE(senders.back()->hold_wide(2 << 20));
}

TEST(RateLimiterTest, EndlessBurstIsPaidLater) {
  RateLimiter pace;
  constexpr double kEndless = std::numeric_limits<double>::infinity();
  EXPECT_EQ(pace.wait_us(0, 100, 100, kSecond), 0);
  EXPECT_TRUE(pace.take(100, 100, kEndless, kSecond));
  EXPECT_EQ(pace.wait_us(0, 100, 100, kSecond), 0) << "the burst";
  EXPECT_TRUE(pace.take(250, 100, kEndless, kSecond));
  EXPECT_EQ(pace.wait_us(0, 100, 100, kSecond), 2'500'000) << "over the burst, and all the same charged";
  EXPECT_EQ(pace.wait_us(0, 100, 100, 2 * kSecond), 1'500'000);
  EXPECT_EQ(pace.wait_us(0, 100, 100, 4 * kSecond), 0);
}

TEST(PolicyTest, ConfigurationErrorsNameTheSetting) {
  const auto why = [](auto change) {
    Config config;
    change(config);
    const auto policy = AccessPolicy::from_config(config);
    return policy ? std::string("accepted") : policy.error().message;
  };
  EXPECT_EQ(why([](Config&) {}), "accepted");
  EXPECT_THAT(why([](Config& c) { c.access.jwt_secret = "short"; }), HasSubstr("access.jwt_secret"));
  EXPECT_THAT(why([](Config& c) { c.access.jwt_keys = {"main ES256"}; }), HasSubstr("access.jwt_keys"));
  EXPECT_THAT(why([](Config& c) { c.access.jwt_keys = {"main none /x"}; }), HasSubstr("'none'"));
  EXPECT_THAT(why([](Config& c) { c.access.jwt_keys = {"main ES256 /nonexistent"}; }), HasSubstr("/nonexistent"));
  EXPECT_THAT(why([](Config& c) { c.access.tokens_file = "/nonexistent"; }), HasSubstr("access.tokens_file"));
  EXPECT_THAT(why([](Config& c) { c.access.anonymous_publish = {"a//b"}; }), HasSubstr("access.anonymous_publish"));
  EXPECT_THAT(why([](Config& c) { c.proxy.trusted = {"all"}; }), HasSubstr("proxy.trusted"));
  EXPECT_THAT(why([](Config& c) { c.access.monitors = {"10.0.0.1/8"}; }), HasSubstr("access.monitors"));
}

}  // namespace
}  // namespace eigencast::broker
