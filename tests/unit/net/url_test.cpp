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

TEST_P(GoodUrl, IsSplitIntoItsParts) {
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
    ::testing::Values(Good{"localhost/heart", false, "localhost", 7490, "heart", "", "ws://localhost:7490"},
                      Good{"localhost", false, "localhost", 7490, "", "", "ws://localhost:7490"},
                      Good{"[::1]/heart?k=2", false, "::1", 7490, "heart", "k=2", "ws://[::1]:7490"},
                      Good{"h:80/a?b=http://c", false, "h", 80, "a", "b=http://c", "ws://h:80"},
                      Good{"http://localhost/heart", false, "localhost", 80, "heart", "", "ws://localhost:80"},
                      Good{"ws://localhost/", false, "localhost", 80, "", "", "ws://localhost:80"},
                      Good{"http://h/a?embed=1&k=3#eye=1,2,3&target=0,0,0", false, "h", 80, "a", "k=3", "ws://h:80"},
                      Good{"WS://h:80/a/b.c", false, "h", 80, "a/b.c", "", "ws://h:80"},
                      Good{"http://10.0.0.1:8080/a?rate=raw&k=3", false, "10.0.0.1", 8080, "a", "rate=raw&k=3",
                           "ws://10.0.0.1:8080"},
                      Good{"wss://broker.example/a", true, "broker.example", 443, "a", "", "wss://broker.example:443"},
                      Good{"https://b/a", true, "b", 443, "a", "", "wss://b:443"},
                      Good{"ws://[::1]:7000/a", false, "::1", 7000, "a", "", "ws://[::1]:7000"},
                      Good{"ws://[fe80::1]/a", false, "fe80::1", 80, "a", "", "ws://[fe80::1]:80"},
                      Good{"ws://h/v1/subscribe/a/b", false, "h", 80, "a/b", "", "ws://h:80"},
                      Good{"ws://h/v1/publish/a?x", false, "h", 80, "a", "x", "ws://h:80"},
                      Good{"ws://h/v1/subscribe", false, "h", 80, "", "", "ws://h:80"},
                      Good{"ws://h/v1/subscribers", false, "h", 80, "v1/subscribers", "", "ws://h:80"},
                      Good{"ws://h?rate=raw", false, "h", 80, "", "rate=raw", "ws://h:80"},
                      Good{"ws://h:65535/a", false, "h", 65535, "a", "", "ws://h:65535"}));

TEST(Url, ErrorsShowNoSecret) {
  for (const char* text : {"ws://a,b:99999/s?access_token=hidden", "ws://a,user:hidden@b/s", "user:hidden@b/s",
                           "ws://a:0/s#access_token=hidden"}) {
    const auto url = parse_broker_url(text);
    ASSERT_FALSE(url) << text;
    EXPECT_EQ(url.error().message.find("hidden"), std::string::npos) << url.error().message;
  }
}

TEST(Url, SecondSchemeIsNamedWithWhatToWrite) {
  for (const char* text : {"ws://a,wss://b/s", "ws://a,ws://b/s", "wss://a:1,https://b:2,c", "ws://a,b,wss://"}) {
    const auto url = parse_broker_url(text);
    ASSERT_FALSE(url) << text;
    EXPECT_NE(url.error().message.find("scheme"), std::string::npos) << url.error().message;
    EXPECT_NE(url.error().message.find("ws://a,b/stream"), std::string::npos) << url.error().message;
  }
  for (const char* text : {"ws://a,b:/s", "ws://a,b://s"}) {
    EXPECT_FALSE(parse_broker_url(text)) << text;
  }
}

TEST(Url, SeveralBrokersShareAllButHostAndPort) {
  const auto url = parse_broker_url("wss://a,[::1]:7000,c:81/live/x?rate=raw&access_token=t");
  ASSERT_TRUE(url) << url.error().message;
  EXPECT_EQ(url->origin(), "wss://a:443,[::1]:7000,c:81");
  EXPECT_EQ(url->shown(), "wss://a:443,[::1]:7000,c:81/live/x");
  ASSERT_EQ(url->brokers(), 3u);
  const char* const origins[] = {"wss://a:443", "wss://[::1]:7000", "wss://c:81"};
  for (std::size_t i = 0; i < 3; ++i) {
    const BrokerUrl one = url->at(i);
    EXPECT_EQ(one.origin(), origins[i]);
    EXPECT_EQ(one.brokers(), 1u);
    EXPECT_EQ(one.stream, "live/x");
    EXPECT_EQ(one.query, "rate=raw");
    EXPECT_EQ(one.credentials.token, "t");
    EXPECT_FALSE(is_same_broker(one, *url));
  }
}

TEST(Url, InvalidUrlsAreRefused) {
  for (const char* url : {"",
                          "ws://a,/x",
                          "ws://,b/x",
                          "ws://a,,b/x",
                          "ws://a,ws://b/x",
                          "ws://a,me@b/x",
                          "ws://a,b:0/x",
                          "ws://a,b:/x",
                          "ws://a, b/x",
                          "ws://a,b,c,d,e,f,g,h,i,j,k,l,m,n,o,p,q/x",
                          "/heart",
                          "//h/heart",
                          "h:/heart",
                          "ftp://h/a",
                          "ws:/h",
                          "ws://",
                          "ws:///a",
                          "ws://:80/a",
                          "ws://h:/a",
                          "ws://h:0/a",
                          "ws://h:65536/a",
                          "ws://h:99999999999999999999/a",
                          "ws://h:8x/a",
                          "ws://h:-1/a",
                          "ws://me:pw@h/a",
                          "ws://[::1/a",
                          "ws://[::1]x/a",
                          "ws://[::1]:/a",
                          "ws://[h]/a",
                          "ws://a b/c",
                          "ws://h/a\r\nX: y",
                          "ws://h/\x7f",
                          "ws://h!/a",
                          "ws://::1/a"}) {
    const auto parsed = parse_broker_url(url);
    ASSERT_FALSE(parsed) << url;
    EXPECT_EQ(parsed.error().code, ErrorCode::kInvalidArgument) << url;
  }
}

TEST(Url, OverlongUrlIsRefused) {
  EXPECT_FALSE(parse_broker_url("ws://h/" + std::string(13000, 'a')));
}

TEST(Url, TokenIsNeverShown) {
  const auto url = parse_broker_url("wss://h/a/b?rate=raw&access_token=abc.d.e&bands=2");
  ASSERT_TRUE(url);
  EXPECT_EQ(url->credentials.token, "abc.d.e");
  EXPECT_EQ(url->query, "rate=raw&bands=2");
  EXPECT_EQ(url->shown(), "wss://h:443/a/b");
  for (const char* text : {"https://h/a#access_token=abc&eye=1,2,3", "h/a#access_token=abc", "h#access_token=abc"}) {
    EXPECT_EQ(parse_broker_url(text)->credentials.token, "abc") << text;
    EXPECT_EQ(parse_broker_url(text)->shown().find("abc"), std::string::npos) << text;
  }
  EXPECT_EQ(parse_broker_url("h/a?access_token=b#access_token=c")->credentials.token, "b");
}

TEST(Url, PathBeforeTheEndpointIsThePrefix) {
  const auto url = parse_broker_url("https://h/eigencast/v1/subscribe/a/b");
  ASSERT_TRUE(url);
  EXPECT_EQ(url->prefix, "/eigencast");
  EXPECT_EQ(url->stream, "a/b");
  EXPECT_EQ(parse_broker_url("ws://h/v1/publish/a")->prefix, "");
  EXPECT_EQ(parse_broker_url("ws://h/v1/subscribers/a")->stream, "v1/subscribers/a");
}

TEST(Credentials, OptionBeatsUrlBeatsEnvironment) {
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

TEST(Credentials, InvalidCredentialsAreRefused) {
  auto url = *parse_broker_url("wss://h/a");
  EXPECT_EQ(complete_credentials(url, {"@/nonexistent", {}}).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(complete_credentials(url, {"@/dev/null", {}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(complete_credentials(url, {"two words", {}}).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(complete_credentials(url, {"a\r\nX-Evil: 1", {}}).error().code, ErrorCode::kInvalidArgument);
  url.credentials = {};
  EXPECT_EQ(complete_credentials(url, {{}, "/nonexistent.pem"}).error().code, ErrorCode::kInvalidArgument);
  url.credentials = {};
  EXPECT_EQ(complete_credentials(url, {{}, {}, "/only.pem"}).error().code, ErrorCode::kInvalidArgument);
  url.credentials = {};
  EXPECT_EQ(complete_credentials(url, {{}, {}, "/a.pem", "/a.key"}).error().code, ErrorCode::kInvalidArgument);
}

TEST(Credentials, InsecureConnectionsAreLogged) {
  std::vector<LogLevel> logged;
  const LogSink log = [&](LogLevel level, std::string_view) { logged.push_back(level); };
  auto url = *parse_broker_url("wss://h/a");
  EXPECT_TRUE(complete_credentials(url, {}, log));
  EXPECT_TRUE(logged.empty());
  EXPECT_FALSE(url.credentials.insecure);
  EXPECT_TRUE(complete_credentials(url, {{}, {}, {}, {}, true}, log));
  EXPECT_EQ(logged, std::vector{LogLevel::kWarning});
}

}  // namespace
}  // namespace eigencast
