// SPDX-License-Identifier: MIT
#include "common/net/url.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

namespace eigencast {
namespace {

struct Good {
  const char* text;
  bool tls;
  const char* host;
  int port;
  const char* stream;
  const char* query;
  const char* origin;
};

class GoodUrl : public ::testing::TestWithParam<Good> {};

TEST_P(GoodUrl, IsTakenApart) {
  const Good& want = GetParam();
  const auto url = parse_broker_url(want.text);
  ASSERT_TRUE(url) << url.error().message;
  EXPECT_EQ(url->tls, want.tls);
  EXPECT_EQ(url->host, want.host);
  EXPECT_EQ(url->port, want.port);
  EXPECT_EQ(url->stream, want.stream);
  EXPECT_EQ(url->query, want.query);
  EXPECT_EQ(url->origin(), want.origin);
}

INSTANTIATE_TEST_SUITE_P(
    Table, GoodUrl,
    ::testing::Values(
        Good{"ws://localhost/heart", false, "localhost", 7490, "heart", "", "ws://localhost:7490"},
        Good{"ws://localhost", false, "localhost", 7490, "", "", "ws://localhost:7490"},
        Good{"ws://localhost/", false, "localhost", 7490, "", "", "ws://localhost:7490"},
        Good{"WS://h:80/a/b.c", false, "h", 80, "a/b.c", "", "ws://h:80"},
        Good{"http://10.0.0.1:8080/a?rate=raw&k=3", false, "10.0.0.1", 8080, "a", "rate=raw&k=3", "ws://10.0.0.1:8080"},
        Good{"wss://broker.example/a", true, "broker.example", 7490, "a", "", "wss://broker.example:7490"},
        Good{"https://b/a", true, "b", 7490, "a", "", "wss://b:7490"},
        Good{"ws://[::1]:7000/a", false, "::1", 7000, "a", "", "ws://[::1]:7000"},
        Good{"ws://[fe80::1]/a", false, "fe80::1", 7490, "a", "", "ws://[fe80::1]:7490"},
        Good{"ws://h/v1/subscribe/a/b", false, "h", 7490, "a/b", "", "ws://h:7490"},
        Good{"ws://h/v1/publish/a?x", false, "h", 7490, "a", "x", "ws://h:7490"},
        Good{"ws://h/v1/subscribe", false, "h", 7490, "", "", "ws://h:7490"},
        Good{"ws://h/v1/subscribers", false, "h", 7490, "v1/subscribers", "", "ws://h:7490"},
        Good{"ws://h?rate=raw", false, "h", 7490, "", "rate=raw", "ws://h:7490"},
        Good{"ws://h:65535/a", false, "h", 65535, "a", "", "ws://h:65535"}));

class BadUrl : public ::testing::TestWithParam<std::pair<const char*, const char*>> {};

TEST_P(BadUrl, IsRefusedWithAReasonAndAnExample) {
  const auto url = parse_broker_url(GetParam().first);
  ASSERT_FALSE(url);
  EXPECT_EQ(url.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(url.error().message, ::testing::HasSubstr(GetParam().second));
  EXPECT_THAT(url.error().message, ::testing::HasSubstr("ws://host:7490/stream"));
}

INSTANTIATE_TEST_SUITE_P(
    Table, BadUrl,
    ::testing::Values(std::pair{"", "must start with"}, std::pair{"localhost/heart", "must start with"},
                      std::pair{"ftp://h/a", "must start with"}, std::pair{"ws:/h", "must start with"},
                      std::pair{"ws://", "host is missing"}, std::pair{"ws:///a", "host is missing"},
                      std::pair{"ws://:80/a", "host is missing"}, std::pair{"ws://h:/a", "port is missing"},
                      std::pair{"ws://h:0/a", "port must be"}, std::pair{"ws://h:65536/a", "port must be"},
                      std::pair{"ws://h:99999999999999999999/a", "port must be"},
                      std::pair{"ws://h:8x/a", "port must be"}, std::pair{"ws://h:-1/a", "port must be"},
                      std::pair{"ws://me:pw@h/a", "user name"}, std::pair{"ws://[::1/a", "']' is missing"},
                      std::pair{"ws://[::1]x/a", "only a port"}, std::pair{"ws://[::1]:/a", "port is missing"},
                      std::pair{"ws://[h]/a", "character"}, std::pair{"ws://a b/c", "space"},
                      std::pair{"ws://h/a\r\nX: y", "space"}, std::pair{"ws://h/\x7f", "space"},
                      std::pair{"ws://h!/a", "character"}, std::pair{"ws://h/a#b", "'#'"},
                      std::pair{"ws://::1/a", "host is missing"}));

TEST(Url, LongerThanALineIsRefused) {
  EXPECT_FALSE(parse_broker_url("ws://h/" + std::string(13000, 'a')));
}

TEST(Url, TheTokenIsTakenOutOfWhatIsShown) {
  const auto url = parse_broker_url("wss://h/a/b?rate=raw&access_token=abc.d.e&bands=2");
  ASSERT_TRUE(url);
  EXPECT_EQ(url->credentials.token, "abc.d.e");
  EXPECT_EQ(url->query, "rate=raw&bands=2");
  EXPECT_EQ(url->shown(), "wss://h:7490/a/b");
}

TEST(Url, WhatStandsBeforeTheEndpointIsThePrefix) {
  const auto url = parse_broker_url("https://h/eigencast/v1/subscribe/a/b");
  ASSERT_TRUE(url);
  EXPECT_EQ(url->prefix, "/eigencast");
  EXPECT_EQ(url->stream, "a/b");
  EXPECT_EQ(parse_broker_url("ws://h/v1/publish/a")->prefix, "");
  EXPECT_EQ(parse_broker_url("ws://h/v1/subscribers/a")->stream, "v1/subscribers/a");
}

TEST(Credentials, GivenWinsOverTheUrlOverTheEnvironment) {
  setenv("EIGENCAST_TOKEN", "from-environment", 1);
  auto plain = *parse_broker_url("ws://h/a");
  auto with = *parse_broker_url("ws://h/a?access_token=from-url");
  EXPECT_TRUE(complete_credentials(plain, {}));
  EXPECT_EQ(plain.credentials.token, "from-environment");
  EXPECT_TRUE(complete_credentials(with, {}));
  EXPECT_EQ(with.credentials.token, "from-url");
  EXPECT_TRUE(complete_credentials(with, {"given", {}}));
  EXPECT_EQ(with.credentials.token, "given");
  unsetenv("EIGENCAST_TOKEN");
}

TEST(Credentials, MistakesShowBeforeAnythingIsConnected) {
  auto url = *parse_broker_url("wss://h/a");
  EXPECT_EQ(complete_credentials(url, {"@/nonexistent", {}}).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(complete_credentials(url, {"two words", {}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(complete_credentials(url, {"a\r\nX-Evil: 1", {}}).error().code, ErrorCode::kInvalidArgument);
  url.credentials = {};
  EXPECT_EQ(complete_credentials(url, {{}, "/nonexistent.pem"}).error().code, ErrorCode::kInvalidArgument);
  url.credentials = {};
  EXPECT_THAT(complete_credentials(url, {{}, {}, "/only.pem"}).error().message, ::testing::HasSubstr("go together"));
  url.credentials = {};
  EXPECT_THAT(complete_credentials(url, {{}, {}, "/a.pem", "/a.key"}).error().message, ::testing::HasSubstr("/a.pem"));
}

TEST(Credentials, LeavingTheCheckOutIsWarnedOf) {
  std::string said;
  const LogSink log = [&](LogLevel, std::string_view text) { said += text; };
  auto url = *parse_broker_url("wss://h/a");
  EXPECT_TRUE(complete_credentials(url, {}, log));
  EXPECT_EQ(said, "");
  EXPECT_FALSE(url.credentials.insecure);
  EXPECT_TRUE(complete_credentials(url, {{}, {}, {}, {}, true}, log));
  EXPECT_THAT(said, ::testing::HasSubstr("--insecure"));
}

}  // namespace
}  // namespace eigencast
