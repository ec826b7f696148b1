// SPDX-License-Identifier: MIT
#include "broker/access/token_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>

#include "broker/access/policy.h"

namespace eigencast::broker {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

std::string hash_of(const std::string& token) {
  return "sha256:" +
         sha256(ByteView(static_cast<const std::uint8_t*>(static_cast<const void*>(token.data())), token.size())).hex();
}

TEST(TokenFileTest, LinesGrantTheirRights) {
  const auto file = TokenFile::from_text(
      "# who sends\n\n  camera-1 " + hash_of("one") + " pub=lab/**,x/*  sub=**\r\nboss\t" + hash_of("two") + " admin",
      "f");
  ASSERT_TRUE(file) << file.error().message;
  EXPECT_EQ(file->size(), 2U);
  const StaticToken* one = file->find("one");
  ASSERT_NE(one, nullptr);
  EXPECT_EQ(one->name, "camera-1");
  EXPECT_TRUE(one->rights.publish.matches("x/y"));
  EXPECT_TRUE(one->rights.subscribe.matches("z"));
  EXPECT_FALSE(one->rights.admin);
  EXPECT_TRUE(file->find("two")->rights.admin);
  for (const char* bad : {"", "on", "one ", "One", "# who sends"}) EXPECT_EQ(file->find(bad), nullptr) << bad;
  EXPECT_EQ(file->find(hash_of("one").substr(7)), nullptr) << "the hash is not the token";
}

TEST(TokenFileTest, MistakesAreReportedWithTheirLine) {
  const std::string hash = hash_of("one");
  const auto why = [](const std::string& text) {
    const auto file = TokenFile::from_text(text, "f");
    return file ? std::string("accepted") : file.error().message;
  };
  EXPECT_THAT(why("\n\ncamera\n"), StartsWith("f:3: "));
  EXPECT_THAT(why("camera secret"), HasSubstr("sha256:"));
  EXPECT_THAT(why("camera sha256:" + std::string(64, 'G')), HasSubstr("sha256:"));
  EXPECT_THAT(why("camera " + hash + " push=**"), HasSubstr("'push=**'"));
  EXPECT_THAT(why("camera " + hash + " pub="), StartsWith("f:1: "));
  EXPECT_THAT(why("camera " + hash + " pub=a,,b"), StartsWith("f:1: "));
  EXPECT_THAT(why("ca/mera " + hash), StartsWith("f:1: "));
  EXPECT_THAT(why("a " + hash + "\nb " + hash), HasSubstr("f:2: 'b'"));
  EXPECT_THAT(why("a " + hash + "\na " + hash_of("two")), HasSubstr("f:2: 'a'"));
}

TEST(TokenFileTest, CreatedTokensAreFoundAndUnique) {
  const auto made = create_static_token("camera-1", {"lab/**", "x"}, {"**"}, true);
  ASSERT_TRUE(made) << made.error().message;
  EXPECT_NE(made->token, create_static_token("camera-1", {"a"}, {}, false)->token);
  EXPECT_EQ(made->line.find(made->token), std::string::npos);
  const auto file = TokenFile::from_text(made->line, "f").value();
  const StaticToken* found = file.find(made->token);
  ASSERT_NE(found, nullptr);
  EXPECT_TRUE(found->rights.admin && found->rights.publish.matches("lab/a") && found->rights.subscribe.matches("q"));
  EXPECT_FALSE(create_static_token("two words", {"a"}, {}, false));
  EXPECT_FALSE(create_static_token("a", {"b//c"}, {}, false));
  EXPECT_FALSE(create_static_token("a", {"b pub=**"}, {}, false));
}

TEST(TokenFileTest, FileThatOthersReachIsWarnedAbout) {
  const std::string path = ::testing::TempDir() + "/eigencast_tokens_" + std::to_string(::getpid());
  std::ofstream(path) << "a " << hash_of("one") << "\n";
  for (const mode_t mode : {0604, 0644, 0660}) {
    chmod(path.c_str(), mode);
    EXPECT_TRUE(TokenFile::from_file(path)) << "a mounted secret may be so";
    EXPECT_EQ(exposure_of(path).find(path), 0u);
  }
  for (const mode_t mode : {0600, 0640, 0400}) {
    chmod(path.c_str(), mode);
    EXPECT_EQ(exposure_of(path), "");
  }
  EXPECT_EQ(exposure_of(""), "");
  EXPECT_EQ(exposure_of(path + "-missing"), "");
  EXPECT_EQ(exposure_of("/dev/null"), "");
  std::remove(path.c_str());
}

}  // namespace
}  // namespace eigencast::broker
