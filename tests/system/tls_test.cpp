// SPDX-License-Identifier: MIT
#include <ctime>

#include "tests/system/access_scene.h"

// Certificates that are accepted and that are not: the messages that people get.
namespace eigencast::testing {
namespace {

using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;

class TlsTest : public AccessTest {
 protected:
  void SetUp() override {
    write_secret(scene_.file("eigencast.toml"), "[access]\nanonymous = \"loopback\"\n");
    if (!make_certificate(scene_, "good")) GTEST_SKIP() << "no openssl";
    scene_.use_tls();
  }
  /// The certificate NAME of the key of "good", which ended yesterday.
  bool make_expired(const std::string& name) {
    std::ofstream(scene_.file("hosts")) << "subjectAltName=IP:127.0.0.1\n";
    Process request({"openssl", "req", "-new", "-key", scene_.file("good.key"), "-subj", "/CN=" + name, "-out",
                     scene_.file("request.pem")},
                    scene_.file("openssl.log"));
    if (request.wait(kPatience) != 0) return false;
    Process sign({"openssl", "x509", "-req", "-in", scene_.file("request.pem"), "-signkey", scene_.file("good.key"),
                  "-days", "-1", "-extfile", scene_.file("hosts"), "-out", scene_.file(name + ".pem")},
                 scene_.file("openssl.log"));
    return sign.wait(kPatience) == 0;
  }
};

TEST_F(TlsTest, ABadCertificateNamesItsRemedy) {
  auto broker = scene_.start_broker(with_tls("good"));
  const std::string good = scene_.file("good.pem");
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--ca", good});
  EXPECT_TRUE(watches("trusted", {"--ca", good})) << scene_.logs();
  EXPECT_THAT(refusal("unknown", {}), HasSubstr("--ca"));
  ASSERT_TRUE(make_certificate(scene_, "other"));
  EXPECT_THAT(refusal("another", {"--ca", scene_.file("other.pem")}), HasSubstr(scene_.file("other.pem")));
  EXPECT_TRUE(watches("insecure", {"--insecure"})) << scene_.logs();
  EXPECT_THAT(text_of(scene_.file("insecure.log")), HasSubstr("--insecure"));
  EXPECT_THAT(text_of(scene_.file("trusted.log")), Not(HasSubstr("--insecure")));
}

TEST_F(TlsTest, ExpiryAndWrongHostAreToldApart) {
  ASSERT_TRUE(make_certificate(scene_, "elsewhere", "DNS:elsewhere.example,DNS:*.lab.example,IP:10.1.2.3"));
  {
    auto broker = scene_.start_broker(with_tls("elsewhere"));
    EXPECT_THAT(refusal("elsewhere-client", {"--ca", scene_.file("elsewhere.pem")}),
                AllOf(HasSubstr("elsewhere.example"), HasSubstr("*.lab.example"), HasSubstr("10.1.2.3")));
  }
  const auto yesterday = [] {
    const std::time_t then = std::time(nullptr) - 86'400;
    char day[16];
    return std::string(day, std::strftime(day, sizeof day, "%Y-%m-%d", std::gmtime(&then)));
  };
  const std::string before = yesterday();
  ASSERT_TRUE(make_expired("expired"));
  const std::string after = yesterday();
  auto broker = scene_.start_broker(
      configured({"--tls-certificate", scene_.file("expired.pem"), "--tls-key", scene_.file("good.key")}));
  EXPECT_TRUE(broker->wait_for_output(scene_.file("expired.pem"), kPatience)) << scene_.logs();
  EXPECT_THAT(refusal("expired-client", {"--ca", scene_.file("expired.pem")}),
              AnyOf(HasSubstr(before), HasSubstr(after)));
}

TEST_F(TlsTest, ClientCertificatesAreRequiredWhenConfigured) {
  ASSERT_TRUE(make_certificate(scene_, "client"));
  ASSERT_TRUE(make_certificate(scene_, "stranger"));
  auto arguments = with_tls("good");
  arguments.insert(arguments.end(), {"--tls-client-ca", scene_.file("client.pem"), "--tls-require-client-certificate"});
  auto broker = scene_.start_broker(arguments);
  const std::string ca = scene_.file("good.pem");
  const auto with = [&](const std::string& name) {
    return std::vector<std::string>{
        "--ca", ca, "--cert", scene_.file(name + ".pem"), "--key", scene_.file(name + ".key")};
  };
  auto of_sender = with("client");
  of_sender.insert(of_sender.begin(), {"torus", "--rate", "30"});
  auto sender = scene_.start_sender(of_sender);
  EXPECT_TRUE(watches("shown", with("client"))) << scene_.logs();
  EXPECT_THAT(refusal("none", {"--ca", ca}), AllOf(HasSubstr("--cert"), HasSubstr("--key")));
  EXPECT_THAT(refusal("not-theirs", with("stranger")), AllOf(HasSubstr("--cert"), HasSubstr("--key")));
  EXPECT_EQ(scene_.run("mixed", {"eigencast-client", scene_.url(), "--headless", "--frames", "1", "--cert",
                                 scene_.file("client.pem"), "--key", scene_.file("good.key")}),
            2);
  EXPECT_THAT(text_of(scene_.file("mixed.log")), HasSubstr("client.pem"));
}

TEST_F(TlsTest, PlainConnectionsAreAdvisedToUseTls) {
  auto broker = scene_.start_broker(with_tls("good"));
  EXPECT_EQ(
      scene_.run("plain", {"eigencast-client", "ws://127.0.0.1:" + scene_.port() + "/a", "--headless", "--wait", "1"}),
      4);
  EXPECT_THAT(text_of(scene_.file("plain.log")), HasSubstr("wss://"));
}

TEST_F(TlsTest, NothingOlderThanTheConfigurationAllowsIsSpoken) {
  auto broker = scene_.start_broker(with_tls("good"));
  int attempts = 0;
  const auto handshake = [&](const std::string& version) {
    Process process({"openssl", "s_client", "-connect", "127.0.0.1:" + scene_.port(), version, "-cipher",
                     "ALL:@SECLEVEL=0", "-no_ign_eof", "-brief"},
                    scene_.file("s_client" + std::to_string(++attempts) + ".log"));
    // It ends by itself at a refusal, or shows the version and waits.
    eventually([&] { return !process.running() || process.output().find("Protocol version") != std::string::npos; });
    return process.output();
  };
  EXPECT_THAT(handshake("-tls1_1"), Not(HasSubstr("Protocol version")));
  EXPECT_THAT(handshake("-tls1_2"), HasSubstr("Protocol version: TLSv1.2"));
  EXPECT_THAT(handshake("-tls1_3"), HasSubstr("Protocol version: TLSv1.3"));
  write_secret(scene_.file("eigencast.toml"), "[tls]\nmin_version = \"1.3\"\n");
  ASSERT_TRUE(reloads(*broker)) << scene_.logs();
  EXPECT_TRUE(broker->wait_for_output("tls.min_version = \"1.3\"", kPatience)) << scene_.logs();
  EXPECT_THAT(handshake("-tls1_2"), Not(HasSubstr("Protocol version")));
}

}  // namespace
}  // namespace eigencast::testing
