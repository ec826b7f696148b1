// SPDX-License-Identifier: MIT
#include "sdk/contexts.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <fstream>

#include "tests/support/process.h"

namespace eigencast {
namespace {

Contexts two() {
  Contexts contexts;
  EXPECT_TRUE(contexts.add({"home", "ws://localhost:7490"}));
  EXPECT_TRUE(
      contexts.add({"studio", "ws://studio.example:1234/live/stage", {"secret", "ca.pem", "c.pem", "c.key", true}}));
  return contexts;
}

TEST(Contexts, FileIsReadableByItsOwnerOnly) {
  const testing::TemporaryFolder folder;
  const std::string path = folder.file("eigencast/contexts.json");
  Contexts contexts = two();
  ASSERT_TRUE(contexts.use("studio"));
  ASSERT_TRUE(contexts.save(path));
  struct stat facts {};
  ASSERT_EQ(::stat(path.c_str(), &facts), 0);
  EXPECT_EQ(facts.st_mode & 0777, 0600u);
  const auto again = Contexts::load(path);
  ASSERT_TRUE(again) << again.error().message;
  EXPECT_EQ(again->current(), "studio");
  ASSERT_EQ(again->all().size(), 2u);
  EXPECT_EQ(again->find("")->credentials.token, "secret");
  EXPECT_EQ(again->find("")->credentials.ca_file, "ca.pem");
  EXPECT_EQ(again->find("")->credentials.certificate_file, "c.pem");
  EXPECT_EQ(again->find("")->credentials.key_file, "c.key");
  EXPECT_TRUE(again->find("")->credentials.insecure);
  EXPECT_EQ(again->find("home")->url, "ws://localhost:7490");
  EXPECT_FALSE(again->find("home")->credentials.insecure);
}

TEST(Contexts, MissingFileIsEmptyBrokenFileIsCorrupt) {
  const testing::TemporaryFolder folder;
  EXPECT_TRUE(Contexts::load(folder.file("none"))->all().empty());
  for (const char* text : {"", "[]", "{\"contexts\": 3}", "{\"contexts\": [3]}",
                           "{\"contexts\": [{\"name\": \"a b\", \"url\": \"ws://x\"}]}", "{\"contexts\""}) {
    std::ofstream(folder.file("broken")) << text;
    EXPECT_FALSE(Contexts::load(folder.file("broken"))) << text;
  }
}

TEST(Contexts, AddReplacesUseSelectsRemoveForgets) {
  Contexts contexts = two();
  EXPECT_EQ(contexts.current(), "home");
  ASSERT_TRUE(contexts.add({"home", "ws://other"}));
  EXPECT_EQ(contexts.find("home")->url, "ws://other");
  EXPECT_EQ(contexts.use("none").error().code, ErrorCode::kNotFound);
  ASSERT_TRUE(contexts.remove("home"));
  EXPECT_EQ(contexts.current(), "studio");
  EXPECT_EQ(contexts.remove("home").error().code, ErrorCode::kNotFound);
  ASSERT_TRUE(contexts.remove("studio"));
  EXPECT_EQ(contexts.current(), "");
  EXPECT_FALSE(contexts.add({"a b", "ws://x"}));
  EXPECT_FALSE(contexts.add({"a", "nonsense://x"}));
}

TEST(Contexts, TargetsAreUrlsStreamsOrContexts) {
  const Contexts contexts = two();
  const auto url = [&](const std::string& to, const std::string& name) {
    return resolve_target(to, {}, name, contexts)->url;
  };
  EXPECT_EQ(url("ws://a/b", ""), "ws://a/b");
  EXPECT_EQ(resolve_target("a/b", {}, "", Contexts())->url, "a/b") << "without a context a broker's";
  EXPECT_EQ(url("demo", ""), "ws://localhost:7490/demo");
  EXPECT_EQ(url("live/x", "studio"), "ws://studio.example:1234/live/x");
  EXPECT_EQ(url("", "studio"), "ws://studio.example:1234/live/stage");
  EXPECT_EQ(resolve_target("demo", {}, "none", contexts).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(resolve_target("demo", {}, "", Contexts()).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(resolve_target("", {}, "", Contexts()).error().code, ErrorCode::kInvalidArgument);
}

TEST(Contexts, UrlFindsTheContextOfItsBroker) {
  const Contexts contexts = two();
  const auto token = [&](const std::string& to, const std::string& name) {
    return resolve_target(to, {}, name, contexts)->credentials.token;
  };
  EXPECT_EQ(contexts.current(), "home");
  EXPECT_EQ(token("ws://studio.example:1234/other", ""), "secret") << "not the current one, but its broker's";
  EXPECT_EQ(token("wss://studio.example:1234/other", ""), "") << "another scheme is another broker";
  EXPECT_EQ(token("ws://studio.example:1234/other", "home"), "") << "another one was named";
}

TEST(Contexts, TokensGoToTheirOwnBrokerOnly) {
  const Contexts contexts = two();
  const auto token = [&](const std::string& to, const std::string& given) {
    return resolve_target(to, {given}, "studio", contexts)->credentials.token;
  };
  EXPECT_EQ(token("demo", ""), "secret");
  EXPECT_EQ(token("ws://studio.example:1234/other", ""), "secret");
  EXPECT_EQ(token("ws://studio.example/other", ""), "");
  EXPECT_EQ(token("ws://elsewhere.example:1234/x", ""), "");
  EXPECT_EQ(token("ws://elsewhere.example:1234/x", "mine"), "mine");
  EXPECT_EQ(token("demo", "mine"), "mine");
  EXPECT_FALSE(resolve_target("ws://elsewhere.example/x", {}, "studio", contexts)->credentials.insecure);
  const Credentials mixed = resolve_target("demo", {"mine", "", "my.pem", "my.key"}, "studio", contexts)->credentials;
  EXPECT_EQ(mixed.ca_file, "ca.pem");
  EXPECT_EQ(mixed.key_file, "my.key");
}

TEST(Contexts, GivenCredentialsGoToOneBrokerOnly) {
  const Contexts contexts = two();
  const Target home{"ws://here.example/a", {"mine", "trusted.pem"}};
  const auto beside = [&](const std::string& to) {
    return resolve_beside(home, to, home.credentials, "", contexts)->credentials;
  };
  EXPECT_EQ(beside("ws://here.example/b").token, "mine");
  EXPECT_EQ(beside("http://here.example:80/b").token, "mine") << "the same broker";
  EXPECT_EQ(beside("ws://elsewhere.example/b").token, "");
  EXPECT_EQ(beside("ws://elsewhere.example/b").ca_file, "trusted.pem");
  EXPECT_EQ(beside("ws://studio.example:1234/b").token, "secret") << "its own context's";
  EXPECT_EQ(beside("demo").token, "") << "at the current context's broker";
}

}  // namespace
}  // namespace eigencast
