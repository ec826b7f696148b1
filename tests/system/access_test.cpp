// SPDX-License-Identifier: MIT
#include <sstream>

#include "tests/system/access_scene.h"

// Which clients are admitted and which are not: real brokers, senders and clients with tokens, over TLS.
namespace eigencast::testing {
namespace {

using ::testing::HasSubstr;

TEST_F(AccessTest, RightsAndTlsAdmitAStream) {
  if (!make_certificate(scene_, "first")) GTEST_SKIP() << "no openssl";
  auto broker = scene_.start_broker(with_tls("first"));
  scene_.use_tls();
  const std::string ca = scene_.file("first.pem");
  const std::string sends = token("sends", {"--publish", "live/**"});
  const std::string views = token("views", {"--subscribe", "live/*"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", sends, "--ca", ca});
  EXPECT_TRUE(watches("a", {"--token", views, "--ca", ca})) << scene_.logs();

  // Delays are measured through the same door.
  std::vector<std::string> measures{"eigencast-latency", "passive", scene_.url(), "--ca", ca,
                                    "--warmup",          "0",       "--duration", "0.5"};
  EXPECT_EQ(scene_.run("unmeasured", measures), 1);
  EXPECT_THAT(text_of(scene_.file("unmeasured.log")), HasSubstr("--token"));
  measures.insert(measures.end(), {"--token", views});
  EXPECT_EQ(scene_.run("measured", measures), 0) << text_of(scene_.file("measured.log"));
  EXPECT_EQ(
      scene_.run("probed", {"eigencast-latency", "probe", scene_.url(), "--ca", ca, "--token", views, "--count", "3"}),
      0)
      << text_of(scene_.file("probed.log"));

  EXPECT_THAT(refusal("no-token", {"--ca", ca}), HasSubstr("--token"));
  EXPECT_THAT(refusal("no-right", {"--ca", ca, "--token", sends}),
              ::testing::AllOf(HasSubstr("'sends'"), HasSubstr("'live/test'")));
  EXPECT_THAT(refusal("no-ca", {"--token", views}), HasSubstr("--ca"));
  EXPECT_THAT(refusal("forged", {"--ca", ca, "--token", text_of(scene_.file("views")).substr(0, 40) + ".x.y"}),
              HasSubstr("401"));
  const std::string brief = token("brief", {"--subscribe", "**", "--valid", "1s"});
  sleep_for(milliseconds(2100));
  EXPECT_THAT(refusal("expired", {"--ca", ca, "--token", brief}), HasSubstr("\"exp\""));
  for (const char* name : {"sends", "views", "brief"}) {
    EXPECT_THAT(broker->output(), ::testing::Not(HasSubstr(text_of(scene_.file(name)).substr(0, 60))))
        << "a token in the log";
  }
}

TEST_F(AccessTest, ARefusalOfOneStreamDoesNotWaitForOthers) {
  auto broker = scene_.start_broker(configured());
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", token("sends", {"--publish", "**"})});
  const std::string views = token("views", {"--subscribe", "live/test"});
  EXPECT_TRUE(watches("first", {"--token", views})) << scene_.logs();
  const std::string other = "http://127.0.0.1:" + scene_.port() + "/live/other";
  EXPECT_THAT(refusal("two", {other, "--token", views}),
              ::testing::AllOf(HasSubstr("no pose comes from"), HasSubstr(other.substr(4)), HasSubstr("'views'")));
}

TEST_F(AccessTest, AnExpiredTokenEndsItsConnection) {
  auto broker = scene_.start_broker(configured());
  const std::string sends = token("sends", {"--publish", "**"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", sends});
  // Baking and uploading are done when somebody sees it.
  EXPECT_TRUE(watches("first", {"--token", token("views", {"--subscribe", "**"})})) << scene_.logs();
  // A busy machine may not join within the first's time.
  for (const char* valid : {"5s", "40s"}) {
    auto client = scene_.start_client(
        "a", {"--token", token("brief", {"--subscribe", "**", "--valid", valid}), "--frames", "1000000"});
    if (!eventually([&] { return !scene_.received("a").empty(); }, milliseconds(20'000))) continue;
    EXPECT_TRUE(eventually([&] { return client_of_kind("viewer").is_null(); }, kPatience)) << scene_.logs();
    EXPECT_TRUE(client->running()) << "the broker ended it";
    return;
  }
  ADD_FAILURE() << "no viewer joined: " << scene_.logs();
}

TEST_F(AccessTest, AReloadTakesOnlyAGoodCertificate) {
  if (!make_certificate(scene_, "first") || !make_certificate(scene_, "second")) {
    GTEST_SKIP() << "no openssl";
  }
  namespace fs = std::filesystem;
  const auto install = [&](const std::string& name) {
    for (const char* kind : {".pem", ".key"}) {
      fs::copy_file(scene_.file(name + kind), scene_.file(std::string("now") + kind),
                    fs::copy_options::overwrite_existing);
    }
  };
  install("first");
  auto broker = scene_.start_broker(with_tls("now"));
  scene_.use_tls();
  const std::string both = token("both", {"--publish", "**", "--subscribe", "**"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", both, "--ca", scene_.file("first.pem")});
  EXPECT_TRUE(watches("before", {"--token", both, "--ca", scene_.file("first.pem")})) << scene_.logs();

  std::ofstream(scene_.file("now.pem")) << "no certificate\n";
  EXPECT_FALSE(reloads(*broker)) << scene_.logs();
  EXPECT_TRUE(watches("still", {"--token", both, "--ca", scene_.file("first.pem")})) << scene_.logs();

  install("second");
  EXPECT_TRUE(reloads(*broker)) << scene_.logs();
  EXPECT_THAT(refusal("old-ca", {"--token", both, "--ca", scene_.file("first.pem")}),
              HasSubstr(scene_.file("first.pem")));
  EXPECT_TRUE(watches("after", {"--token", both, "--ca", scene_.file("second.pem")}))
      << "the sender's connection was kept: " << scene_.logs();
}

TEST_F(AccessTest, AnonymousBeyondLoopbackIsRefusedBeforeItListens) {
  EXPECT_EQ(scene_.run("open", {"eigencast-broker", "--listen", "0.0.0.0:0", "--data-dir", scene_.file("assets")}), 2);
  EXPECT_THAT(text_of(scene_.file("open.log")), HasSubstr("server.listen = "));
  EXPECT_EQ(scene_.run("checked", {"eigencast-broker", "--listen", "0.0.0.0:0", "--check-config", "--config",
                                   scene_.file("eigencast.toml")}),
            0);
  write_secret(scene_.file("eigencast.toml"), "[access]\njwt_keys = [\"main HS256 /nonexistent\"]\n");
  EXPECT_EQ(scene_.run("broken", {"eigencast-broker", "--check-config", "--config", scene_.file("eigencast.toml")}), 2);
  EXPECT_THAT(text_of(scene_.file("broken.log")), HasSubstr("access.jwt_keys: /nonexistent"));
}

TEST_F(AccessTest, FixedTokensAdmitAndInspectPrintsTheirRights) {
  EXPECT_EQ(scene_.run("made", {"eigencast-broker", "token", "create", "--static", "--subject", "cam", "--publish",
                                "live/**", "--subscribe", "live/**"}),
            0);
  // Token and line, in one file here.
  std::istringstream lines(text_of(scene_.file("made.log")));
  std::string secret;
  std::string line;
  for (std::string text; std::getline(lines, text);) {
    if (text.starts_with("ect_")) secret = text;
    if (text.starts_with("cam sha256:")) line = text;
  }
  ASSERT_FALSE(secret.empty() || line.empty()) << text_of(scene_.file("made.log"));
  write_secret(scene_.file("tokens"), "# of the tests\n" + line + "\n");
  write_secret(scene_.file("eigencast.toml"),
               "[access]\nanonymous = \"nowhere\"\ntokens_file = \"" + scene_.file("tokens") + "\"\n");
  auto broker = scene_.start_broker(configured());
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", secret});
  EXPECT_TRUE(watches("a", {"--token", secret})) << scene_.logs();
  EXPECT_THAT(refusal("wrong", {"--token", "ect_" + std::string(64, '0')}), HasSubstr(" 401"));
  // Senders learn it before they bake.
  const auto turned_away = [&](const std::string& name, const std::string& token, const std::string& url) {
    EXPECT_EQ(scene_.run(name, {"eigencast-sender", "play", "torus", "--cache", scene_.file("unused"), "--token", token,
                                "--to", url}),
              4);
    EXPECT_FALSE(std::filesystem::exists(scene_.file("unused")));
    return text_of(scene_.file(name + ".log"));
  };
  EXPECT_THAT(turned_away("guess", "ect_" + std::string(64, '0'), scene_.url()), HasSubstr(" 401"));
  EXPECT_THAT(turned_away("astray", secret, "http://127.0.0.1:" + scene_.port() + "/other"), HasSubstr("'other'"));
  const std::vector<std::string> inspect = {
      "eigencast-broker", "token", "inspect", "--config", scene_.file("eigencast.toml"), secret};
  auto may = inspect;
  may.insert(may.end(), {"--publish", "live/x"});
  EXPECT_EQ(scene_.run("may", may), 0);
  auto may_not = inspect;
  may_not.insert(may_not.end(), {"--publish", "other"});
  EXPECT_EQ(scene_.run("may-not", may_not), 1);
}

}  // namespace
}  // namespace eigencast::testing
