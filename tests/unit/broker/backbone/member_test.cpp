// SPDX-License-Identifier: MIT
#include "broker/backbone/member.h"

#include <gmock/gmock.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

namespace eigencast::broker {
namespace {

using ::testing::HasSubstr;

class MemberTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(folder_);
    ::setenv("CREDENTIALS_DIRECTORY", folder_.c_str(), 1);
    config_.backbone.servers = {"nats://127.0.0.1:4222"};
  }
  void TearDown() override {
    ::unsetenv("CREDENTIALS_DIRECTORY");
    std::filesystem::remove_all(folder_);
  }
  std::string folder_ = ::testing::TempDir() + "/eigencast-member-" + std::to_string(::getpid());
  Config config_;
};

TEST_F(MemberTest, CredentialsAreFoundInSystemdFolder) {
  EXPECT_TRUE(Member::check(config_));
  config_.backbone.credentials = "broker.creds";
  const auto absent = Member::check(config_);
  ASSERT_FALSE(absent);
  EXPECT_THAT(absent.error().message, HasSubstr("backbone.credentials"));
  EXPECT_THAT(absent.error().message, HasSubstr("broker.creds"));
  std::ofstream(folder_ + "/broker.creds") << "x";
  EXPECT_TRUE(Member::check(config_));
}

TEST_F(MemberTest, UnreadableAuthoritiesAreRefused) {
  config_.backbone.ca = "ca.pem";
  std::ofstream(folder_ + "/ca.pem") << "no certificate";
  const auto refused = Member::check(config_);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("backbone.ca"));
  config_.backbone.servers.clear();
  EXPECT_TRUE(Member::check(config_)) << "a broker that stands alone reads none of it";
}

}  // namespace
}  // namespace eigencast::broker
