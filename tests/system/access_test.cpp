// SPDX-License-Identifier: MIT
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>

#include "tests/system/scene.h"

// Who is let in and who is not: real brokers, senders and clients with tokens over TLS, and a real nginx.
namespace eigencast::testing {
namespace {

using ::testing::HasSubstr;

constexpr milliseconds kLong{60'000};

void write_secret(const std::string& path, const std::string& text) {
  std::ofstream(path) << text;
  chmod(path.c_str(), 0600);
}

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// A self-signed certificate for localhost and 127.0.0.1, as NAME.pem and NAME.key; false without the openssl program.
bool make_certificate(const Scene& scene, const std::string& name) {
  if (!std::filesystem::exists("/usr/bin/openssl")) return false;
  Process openssl({"/usr/bin/openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days",
                   "30", "-subj", "/CN=" + name, "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-keyout",
                   scene.file(name + ".key"), "-out", scene.file(name + ".pem")},
                  scene.file("openssl.log"));
  const bool made = openssl.wait(kLong) == 0;
  chmod(scene.file(name + ".key").c_str(), 0600);
  return made;
}

class AccessTest : public ::testing::Test {
 protected:
  void SetUp() override {
    write_secret(scene_.file("main.secret"), "a secret of the tests, of more than 32 bytes");
    std::ofstream(scene_.file("eigencast.toml")) << "[access]\nanonymous = \"nowhere\"\njwt_leeway_s = 0\njwt_keys = [\"main HS256 "
                                                 << scene_.file("main.secret") << "\"]\n";
  }
  std::vector<std::string> configured(std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"--config", scene_.file("eigencast.toml")});
    return more;
  }
  std::vector<std::string> with_tls(const std::string& name) const {
    return configured({"--tls-certificate", scene_.file(name + ".pem"), "--tls-key", scene_.file(name + ".key")});
  }
  /// A token with these rights, in the file NAME; gives "@FILE".
  std::string token(const std::string& name, std::vector<std::string> rights) {
    std::vector<std::string> all{"eigencast-broker", "token", "create", "--config", scene_.file("eigencast.toml"),
                                 "--subject", name};
    all.insert(all.end(), rights.begin(), rights.end());
    std::filesystem::remove(scene_.file(name + ".log"));
    EXPECT_EQ(scene_.run(name, all), 0) << text_of(scene_.file(name + ".log"));
    write_secret(scene_.file(name), text_of(scene_.file(name + ".log")));
    std::filesystem::remove(scene_.file(name + ".log"));
    return "@" + scene_.file(name);
  }
  /// Whether a client got poses.
  bool watches(const std::string& name, std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--frames", "5", "--wait", "20"});
    auto client = scene_.start_client(name, arguments);
    const bool good = client->wait(kLong) == 0;
    return good && scene_.received(name).size() >= 5;
  }
  /// What a client that is not let in says.
  std::string refusal(const std::string& name, std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--frames", "5", "--wait", "2"});
    auto client = scene_.start_client(name, arguments);
    EXPECT_EQ(client->wait(kLong), 4) << client->output();
    return client->output();
  }

  Scene scene_;
};

TEST_F(AccessTest, AStreamFlowsOverTlsForThoseWithTheRight) {
  if (!make_certificate(scene_, "first")) GTEST_SKIP() << "no openssl program here: TLS is not tested";
  auto broker = scene_.start_broker(with_tls("first"));
  scene_.use_tls();
  const std::string ca = scene_.file("first.pem");
  const std::string sends = token("sends", {"--publish", "live/**"});
  const std::string looks = token("looks", {"--subscribe", "live/*"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", sends, "--ca", ca});
  EXPECT_TRUE(watches("a", {"--token", looks, "--ca", ca})) << scene_.logs();

  EXPECT_THAT(refusal("no-token", {"--ca", ca}), HasSubstr("give a token with --token"));
  EXPECT_THAT(refusal("no-right", {"--ca", ca, "--token", sends}), HasSubstr("token 'sends' may not subscribe 'live/test'"));
  EXPECT_THAT(refusal("no-ca", {"--token", looks}), HasSubstr("is not trusted"));
  EXPECT_THAT(refusal("forged", {"--ca", ca, "--token", text_of(scene_.file("looks")).substr(0, 40) + ".x.y"}), HasSubstr("401"));
  const std::string brief = token("brief", {"--subscribe", "**", "--valid", "1s"});
  sleep_for(milliseconds(2100));
  EXPECT_THAT(refusal("expired", {"--ca", ca, "--token", brief}), HasSubstr("expired"));
  for (const char* name : {"sends", "looks", "brief"}) {
    EXPECT_THAT(broker->output(), ::testing::Not(HasSubstr(text_of(scene_.file(name)).substr(0, 60)))) << "a token in the log";
  }
}

TEST_F(AccessTest, ATokenThatRunsOutEndsItsConnection) {
  auto broker = scene_.start_broker(configured());
  const std::string sends = token("sends", {"--publish", "**"});
  const std::string brief = token("brief", {"--subscribe", "**", "--valid", "4s"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", sends});
  auto client = scene_.start_client("a", {"--token", brief, "--duration", "12"});
  EXPECT_TRUE(broker->wait_for_output("has expired", kLong)) << scene_.logs();
  client->wait(kLong);
  EXPECT_FALSE(scene_.received("a").empty()) << scene_.logs();
}

TEST_F(AccessTest, AReloadTakesANewCertificateAndRefusesABadOne) {
  if (!make_certificate(scene_, "first") || !make_certificate(scene_, "second")) {
    GTEST_SKIP() << "no openssl program here: TLS is not tested";
  }
  namespace fs = std::filesystem;
  const auto install = [&](const std::string& name) {
    for (const char* kind : {".pem", ".key"}) {
      fs::copy_file(scene_.file(name + kind), scene_.file(std::string("now") + kind), fs::copy_options::overwrite_existing);
    }
  };
  install("first");
  auto broker = scene_.start_broker(with_tls("now"));
  scene_.use_tls();
  const std::string both = token("both", {"--publish", "**", "--subscribe", "**"});
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", both, "--ca", scene_.file("first.pem")});
  EXPECT_TRUE(watches("before", {"--token", both, "--ca", scene_.file("first.pem")})) << scene_.logs();

  std::ofstream(scene_.file("now.pem")) << "no certificate\n";
  broker->signal(SIGHUP);
  EXPECT_TRUE(broker->wait_for_output("not reloaded, everything stays as it was", kLong)) << scene_.logs();
  EXPECT_TRUE(watches("still", {"--token", both, "--ca", scene_.file("first.pem")})) << scene_.logs();

  install("second");
  broker->signal(SIGHUP);
  EXPECT_TRUE(broker->wait_for_output("the configuration is reloaded", kLong)) << scene_.logs();
  EXPECT_THAT(refusal("old-ca", {"--token", both, "--ca", scene_.file("first.pem")}), HasSubstr("is not trusted"));
  EXPECT_TRUE(watches("after", {"--token", both, "--ca", scene_.file("second.pem")})) << "the sender's connection was kept: "
                                                                                      << scene_.logs();
}

TEST_F(AccessTest, AnonymousBeyondLoopbackIsRefusedBeforeItListens) {
  EXPECT_EQ(scene_.run("open", {"eigencast-broker", "--listen", "0.0.0.0:0", "--data-dir", scene_.file("assets")}), 2);
  EXPECT_THAT(text_of(scene_.file("open.log")), HasSubstr("nobody there could show who they are"));
  EXPECT_EQ(scene_.run("checked", {"eigencast-broker", "--listen", "0.0.0.0:0", "--check-config", "--config",
                                   scene_.file("eigencast.toml")}),
            0);
  write_secret(scene_.file("eigencast.toml"), "[access]\njwt_keys = [\"main HS256 /nonexistent\"]\n");
  EXPECT_EQ(scene_.run("broken", {"eigencast-broker", "--check-config", "--config", scene_.file("eigencast.toml")}), 2);
  EXPECT_THAT(text_of(scene_.file("broken.log")), HasSubstr("access.jwt_keys: /nonexistent"));
}

TEST_F(AccessTest, FixedTokensOpenTheDoorAndInspectSaysWhatFor) {
  EXPECT_EQ(scene_.run("made", {"eigencast-broker", "token", "create", "--static", "--subject", "cam", "--publish", "live/**",
                                "--subscribe", "live/**"}),
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
  write_secret(scene_.file("eigencast.toml"), "[access]\nanonymous = \"nowhere\"\ntokens_file = \"" + scene_.file("tokens") + "\"\n");
  auto broker = scene_.start_broker(configured());
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--token", secret});
  EXPECT_TRUE(watches("a", {"--token", secret})) << scene_.logs();
  EXPECT_THAT(refusal("wrong", {"--token", "ect_" + std::string(64, '0')}), HasSubstr("does not know the token"));
  const std::vector<std::string> inspect = {"eigencast-broker", "token", "inspect", "--config", scene_.file("eigencast.toml"), secret};
  auto may = inspect;
  may.insert(may.end(), {"--publish", "live/x"});
  EXPECT_EQ(scene_.run("may", may), 0);
  auto may_not = inspect;
  may_not.insert(may_not.end(), {"--publish", "other"});
  EXPECT_EQ(scene_.run("may-not", may_not), 1);
  EXPECT_THAT(text_of(scene_.file("may-not.log")), HasSubstr("may not publish other"));
}

/// A port that was free a moment ago.
int free_port() {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  auto* generic = static_cast<sockaddr*>(static_cast<void*>(&address));
  EXPECT_EQ(::bind(fd, generic, size), 0);
  EXPECT_EQ(::getsockname(fd, generic, &size), 0);
  ::close(fd);
  return ntohs(address.sin_port);
}

TEST_F(AccessTest, BehindNginxOnASubPathOverTls) {
  if (!std::filesystem::exists("/usr/sbin/nginx")) GTEST_SKIP() << "nginx is not installed: nothing is known about it here";
  ASSERT_TRUE(make_certificate(scene_, "proxy"));
  write_secret(scene_.file("eigencast.toml"), "[proxy]\ntrusted = [\"127.0.0.1\"]\n");
  auto broker = scene_.start_broker(configured());
  const std::string port = std::to_string(free_port());
  std::ofstream(scene_.file("nginx.conf"))
      << "pid " << scene_.file("nginx.pid") << ";\nerror_log stderr;\ndaemon off;\nevents {}\nhttp {\naccess_log off;\n"
      << "client_body_temp_path " << scene_.file("body") << ";\nproxy_temp_path " << scene_.file("temp")
      << ";\nfastcgi_temp_path " << scene_.file("f") << ";\nuwsgi_temp_path " << scene_.file("u") << ";\nscgi_temp_path "
      << scene_.file("s") << ";\nmap $http_upgrade $eigencast_connection { default upgrade; '' ''; }\nserver {\nlisten 127.0.0.1:" << port
      << " ssl;\nssl_certificate " << scene_.file("proxy.pem") << ";\nssl_certificate_key " << scene_.file("proxy.key")
      << ";\nlocation /eigencast/ {\nproxy_pass http://127.0.0.1:" << scene_.port()
      << "/;\nproxy_http_version 1.1;\nproxy_set_header Host $host;\nproxy_set_header Upgrade $http_upgrade;\n"
      << "proxy_set_header Connection $eigencast_connection;\nproxy_set_header X-Forwarded-For $remote_addr;\n"
      << "proxy_buffering off;\nproxy_request_buffering off;\nclient_max_body_size 256m;\n}\n}\n}\n";
  Process nginx({"/usr/sbin/nginx", "-c", scene_.file("nginx.conf"), "-e", "stderr", "-p", scene_.file("")}, scene_.file("nginx.log"));
  ASSERT_TRUE(eventually([&] { return std::filesystem::exists(scene_.file("nginx.pid")) || !nginx.running(); }));
  ASSERT_TRUE(nginx.running()) << nginx.output();
  const std::string proxy = "wss://localhost:" + port + "/eigencast/v1/";
  const std::string ca = scene_.file("proxy.pem");
  auto sender = scene_.start_sender({"torus", "--rate", "30", "--ca", ca}, proxy + "publish/live/test");
  scene_.watch(proxy + "subscribe/live/test");
  EXPECT_TRUE(watches("local", {"--ca", ca})) << "a local viewer through a named proxy is local: " << scene_.logs();

  // The same viewer, when the proxy is not named: no longer known to be local.
  write_secret(scene_.file("eigencast.toml"), "[proxy]\ntrusted = []\n");
  broker->signal(SIGHUP);
  ASSERT_TRUE(broker->wait_for_output("the configuration is reloaded", kLong)) << scene_.logs();
  EXPECT_THAT(refusal("unnamed", {"--ca", ca}), HasSubstr("proxy.trusted"));
  nginx.signal(SIGQUIT);
  nginx.wait(milliseconds(5000));
}

}  // namespace
}  // namespace eigencast::testing
