// SPDX-License-Identifier: MIT
#include <arpa/inet.h>
#include <ifaddrs.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <memory>
#include <utility>

#include "tests/system/access_scene.h"

// Behind a real nginx that runs deploy/nginx/eigencast.conf: names, ports, paths and times replaced, nothing else.
namespace eigencast::testing {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

sockaddr* generic(sockaddr_in* address) {
  return static_cast<sockaddr*>(static_cast<void*>(address));
}

/// A port that was free a moment ago.
std::string free_port() {
  const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  socklen_t size = sizeof(address);
  EXPECT_EQ(::bind(fd, generic(&address), size), 0);
  EXPECT_EQ(::getsockname(fd, generic(&address), &size), 0);
  ::close(fd);
  return std::to_string(ntohs(address.sin_port));
}

/// An address of this machine that is not on loopback: a client that connects to it comes from it. Empty: there is
/// none.
std::string outer_address() {
  ifaddrs* all = nullptr;
  if (::getifaddrs(&all) != 0) return {};
  std::string found;
  for (const ifaddrs* one = all; one != nullptr && found.empty(); one = one->ifa_next) {
    if (one->ifa_addr == nullptr || one->ifa_addr->sa_family != AF_INET) continue;
    const auto* address = static_cast<const sockaddr_in*>(static_cast<const void*>(one->ifa_addr));
    const std::string text = ::inet_ntoa(address->sin_addr);
    if (!text.starts_with("127.")) found = text;
  }
  ::freeifaddrs(all);
  return found;
}

class ProxyTest : public AccessTest {
 protected:
  void SetUp() override {
    AccessTest::SetUp();
    if (!on_path("nginx")) GTEST_SKIP() << "no nginx";
    if (!make_certificate(scene_, "proxy")) GTEST_SKIP() << "no openssl";
  }
  void TearDown() override {
    if (!nginx_) return;
    nginx_->signal(SIGQUIT);
    nginx_->wait(kPatience);
  }

  /// The shipped file as it is, but for `changes` (each must occur) and what a machine must replace.
  std::string site(const std::vector<std::pair<std::string, std::string>>& changes) {
    std::string text = text_of(EIGENCAST_NGINX_SITE);
    std::vector<std::pair<std::string, std::string>> all = {
        {"listen 80;", "listen 127.0.0.1:" + free_port() + ";"},
        {"listen [::]:80;", ""},
        {"listen 443 ssl http2;", "listen 0.0.0.0:" + port_ + " ssl http2;"},
        {"listen [::]:443 ssl http2;", ""},
        {"surfaces.example.org", "localhost"},
        {"/etc/ssl/certs/localhost.pem", scene_.file("proxy.pem")},
        {"/etc/ssl/private/localhost.key", scene_.file("proxy.key")},
        {"127.0.0.1:7490", "127.0.0.1:" + scene_.port()},
        {"/var/log/nginx/eigencast.log", scene_.file("access.log")},
        {"/var/log/nginx/eigencast-error.log", scene_.file("error.log")},
        {"/var/cache/nginx-eigencast", scene_.file("kept")}};
    all.insert(all.end(), changes.begin(), changes.end());
    for (const auto& [from, to] : all) {
      EXPECT_NE(text.find(from), std::string::npos) << "deploy/nginx/eigencast.conf has changed: no " << from;
      for (auto at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size()))
        text.replace(at, from.size(), to);
    }
    return text;
  }
  /// nginx with the shipped site in front of the broker. Another test may take the port first: then once more.
  void start_nginx(const std::vector<std::pair<std::string, std::string>>& changes = {}) {
    for (int tries = 0; tries < 3; ++tries) {
      port_ = free_port();
      std::ofstream(scene_.file("site.conf")) << site(changes);
      std::ofstream conf(scene_.file("nginx.conf"));
      // As root, nginx would give up its rights to the scene's folder.
      if (::geteuid() == 0) conf << "user root;\n";
      conf << "pid " << scene_.file("nginx.pid")
           << ";\nerror_log stderr;\ndaemon off;\nworker_processes 1;\nevents {}\nhttp {\naccess_log off;\n";
      for (const char* kind : {"client_body", "proxy", "fastcgi", "uwsgi", "scgi"}) {
        conf << kind << "_temp_path " << scene_.file(std::string("temp-") + kind) << ";\n";
      }
      conf << "include " << scene_.file("site.conf") << ";\n}\n";
      conf.close();
      std::filesystem::remove(scene_.file("nginx.pid"));
      nginx_ = std::make_unique<Process>(
          std::vector<std::string>{"nginx", "-c", scene_.file("nginx.conf"), "-e", "stderr", "-p", scene_.file("")},
          scene_.file("nginx.log"));
      ASSERT_TRUE(eventually([&] { return std::filesystem::exists(scene_.file("nginx.pid")) || !nginx_->running(); }));
      if (nginx_->running()) break;
    }
    ASSERT_TRUE(nginx_->running()) << nginx_->output();
    scene_.watch(url("wss", "subscribe/live/test"));
  }
  std::string url(const std::string& scheme, const std::string& path, const std::string& host = "localhost") const {
    return scheme + "://" + host + ":" + port_ + "/eigencast/v1/" + path;
  }
  std::unique_ptr<Process> start_sender(std::vector<std::string> more = {}) {
    more.insert(more.begin(), {"torus", "--rate", "30", "--ca", scene_.file("proxy.pem")});
    return scene_.start_sender(std::move(more), url("wss", "publish/live/test"));
  }
  /// The head and body that come back. A request by address, not by name, does not check the certificate.
  std::string curl(const std::string& target, std::vector<std::string> arguments = {}) {
    const std::string log = scene_.file("curl-" + std::to_string(++curls_) + ".log");
    arguments.insert(arguments.begin(),
                     {"curl", "--silent", "--show-error", "--include", "--insecure", "--max-time", "20", target});
    Process process(std::move(arguments), log);
    process.wait(kPatience);
    return process.output();
  }
  /// The URL of the asset that the stream shows.
  std::string asset_url(const std::vector<std::string>& headers) {
    std::string name;
    eventually([&] {
      const std::string streams = curl(url("https", "streams"), headers);
      const auto at = streams.find("\"asset\":\"");
      if (at != std::string::npos) name = streams.substr(at + 9, 64);
      return name.size() == 64 && name.find('"') == std::string::npos;
    });
    return url("https", "assets/" + name);
  }
  bool reloads(Process& broker, const std::string& configuration) {
    write_secret(scene_.file("eigencast.toml"), configuration);
    return AccessTest::reloads(broker);
  }

  std::string port_;
  std::unique_ptr<Process> nginx_;
  int curls_ = 0;
};

TEST_F(ProxyTest, ASubPathStreamsAndProxiedClientsAreNotLocal) {
  const std::string trusted = "[proxy]\ntrusted = [\"127.0.0.1\"]\n";
  write_secret(scene_.file("eigencast.toml"), "[access]\nanonymous = \"anywhere\"\n" + trusted);
  auto broker = scene_.start_broker(configured());
  ASSERT_NO_FATAL_FAILURE(start_nginx());
  auto sender = start_sender();
  const std::string ca = scene_.file("proxy.pem");
  EXPECT_TRUE(watches("anybody", {"--ca", ca})) << scene_.logs();
  const std::string name = "https://localhost:" + port_ + "/eigencast/lab/horse";
  EXPECT_THAT(curl(name, {"--header", "Accept: application/json"}), HasSubstr("\"../v1/subscribe/lab/horse\""));
  for (const std::string& proxies : {trusted, std::string("[proxy]\ntrusted = []\n")}) {
    ASSERT_TRUE(reloads(*broker, "[access]\nanonymous = \"loopback\"\n" + proxies));
    EXPECT_THAT(refusal("claimed", {"--ca", ca}), HasSubstr(" 401"));
  }
}

TEST_F(ProxyTest, ForgedClientAddressesAreIgnored) {
  const std::string outside = outer_address();
  if (outside.empty()) GTEST_SKIP() << "this machine has no address but loopback";
  if (!on_path("curl")) GTEST_SKIP() << "no curl";
  write_secret(scene_.file("eigencast.toml"), "[proxy]\ntrusted = [\"127.0.0.1\"]\n");
  auto broker = scene_.start_broker(configured());
  ASSERT_NO_FATAL_FAILURE(start_nginx());
  EXPECT_THAT(curl(url("https", "streams")), HasSubstr(" 401")) << "127.0.0.1, but through a proxy";
  const std::string target = url("https", "streams", outside), host = "Host: localhost:" + port_;
  EXPECT_THAT(curl(target, {"--header", host}), HasSubstr(" 401")) << "anonymous, from elsewhere";
  for (const char* forged : {"X-Forwarded-For: 127.0.0.1", "Forwarded: for=127.0.0.1", "X-Real-IP: 127.0.0.1",
                             "X-Forwarded-For: 127.0.0.1, 127.0.0.1", "Forwarded: for=\"[::1]\";proto=https"}) {
    EXPECT_THAT(curl(target, {"--header", host, "--header", forged}), HasSubstr(" 401")) << forged;
  }
  // A page's host as the proxy says it, not as the client does.
  const std::string page = "Origin: https://elsewhere.example";
  EXPECT_THAT(curl(url("https", "streams"), {"--header", page}), HasSubstr(" 403"));
  EXPECT_THAT(curl(url("https", "streams"), {"--header", page, "--header", "X-Forwarded-Host: elsewhere.example"}),
              HasSubstr(" 403"));
}

TEST_F(ProxyTest, OtherHostsAreNotServed) {
  if (!on_path("curl")) GTEST_SKIP() << "no curl";
  write_secret(scene_.file("eigencast.toml"),
               "[access]\nanonymous = \"anywhere\"\n[proxy]\ntrusted = [\"127.0.0.1\"]\n");
  auto broker = scene_.start_broker(configured());
  ASSERT_NO_FATAL_FAILURE(start_nginx());
  const std::string page = "Origin: https://evil.example";
  for (const char* host : {"Host: evil.example", "Host: evil.example:443", "Host: 127.0.0.1"})
    EXPECT_THAT(curl(url("https", "streams"), {"--http1.1", "--header", host, "--header", page}), HasSubstr(" 421"));
  const std::vector<std::string> both = {"--http1.1", "--request-target", url("https", "streams"), "--header",
                                         "Host: evil.example"};
  EXPECT_THAT(curl(url("https", "streams"), both), HasSubstr(" 421")) << "two hosts: one for nginx, one for the broker";
  EXPECT_THAT(curl(url("https", "streams"), {"--header", page}), HasSubstr(" 403")) << "its host, a page of another";
  EXPECT_THAT(curl(url("https", "streams")), HasSubstr(" 200"));
}

TEST_F(ProxyTest, LogsHoldNoTokens) {
  if (!on_path("curl")) GTEST_SKIP() << "no curl";
  auto broker = scene_.start_broker(configured());
  ASSERT_NO_FATAL_FAILURE(start_nginx());
  const std::string secret = "a-token-in-the-query";
  EXPECT_THAT(curl(url("https", "streams?access_token=" + secret)), HasSubstr(" 401"));
  broker->signal(SIGKILL);
  broker->wait(kPatience);
  EXPECT_THAT(curl(url("https", "streams?access_token=" + secret)), HasSubstr(" 502"));
  EXPECT_TRUE(eventually([&] { return text_of(scene_.file("access.log")).find("\" 502 ") != std::string::npos; }));
  for (const char* log : {"access.log", "error.log", "nginx.log"}) {
    EXPECT_EQ(text_of(scene_.file(log)).find(secret), std::string::npos) << log;
  }
}

TEST_F(ProxyTest, AnIdleViewerOutlivesTheProxyTimeout) {
  // An hour of silence at 60 s and pings every 15 s; here seconds, in the same ratio of four pings to a timeout.
  write_secret(scene_.file("eigencast.toml"),
               "[access]\nanonymous = \"anywhere\"\n[proxy]\ntrusted = [\"127.0.0.1\"]\n");
  auto broker = scene_.start_broker(configured({"--timeouts-idle-ms", "4000"}));
  ASSERT_NO_FATAL_FAILURE(start_nginx(
      {{"proxy_read_timeout 60s", "proxy_read_timeout 8s"}, {"proxy_send_timeout 60s", "proxy_send_timeout 8s"}}));
  const std::string ca = scene_.file("proxy.pem");
  auto client = scene_.start_client("idle", {"--ca", ca, "--frames", "5", "--wait", "60"});
  ASSERT_TRUE(eventually([&] { return metric("eigencast_broker_subscriptions") == 1; }, kPatience)) << scene_.logs();
  sleep_for(milliseconds(10000));
  EXPECT_TRUE(client->running()) << scene_.logs();
  EXPECT_THAT(nginx_->output(), Not(HasSubstr("timed out")));
  auto sender = start_sender();
  EXPECT_EQ(client->wait(kPatience), 0) << scene_.logs();
  EXPECT_GE(scene_.received("idle").size(), 5U);
  EXPECT_EQ(scene_.reconnects("idle", *client), 0U) << "the idle connection was cut: " << scene_.logs();
}

TEST_F(ProxyTest, OnlyPublicAssetsAreCached) {
  if (!on_path("curl")) GTEST_SKIP() << "no curl";
  const std::string keys = "jwt_keys = [\"main HS256 " + scene_.file("main.secret") + "\"]\n";
  const std::string trusted = "[proxy]\ntrusted = [\"127.0.0.1\"]\n";
  write_secret(scene_.file("eigencast.toml"),
               "[access]\nanonymous = \"anywhere\"\norigins = [\"https://viewer.example\"]\n" + keys + trusted);
  auto broker = scene_.start_broker(configured());
  ASSERT_NO_FATAL_FAILURE(start_nginx());
  auto sender = start_sender();
  const std::string asset = asset_url({});
  const std::string first = curl(asset, {"--output", "/dev/null", "--dump-header", "-"});
  EXPECT_THAT(first, HasSubstr("public, max-age=31536000, immutable"));
  EXPECT_THAT(first, HasSubstr("MISS"));
  EXPECT_THAT(curl(asset, {"--output", "/dev/null", "--dump-header", "-"}), HasSubstr("HIT"));
  const std::string part = curl(asset, {"--range", "5-14", "--output", "/dev/null", "--dump-header", "-"});
  EXPECT_THAT(part, HasSubstr(" 206"));
  EXPECT_THAT(part, HasSubstr("HIT"));
  for (int i = 0; i < 2; ++i) {  // The copy of those without an origin is not for pages.
    EXPECT_THAT(
        curl(asset, {"--header", "Origin: https://viewer.example", "--output", "/dev/null", "--dump-header", "-"}),
        HasSubstr("access-control-allow-origin: https://viewer.example"));
  }

  // Once tokens count, what is answered to one reader is not kept for others. (The cache is emptied by the test's
  // reload.)
  std::filesystem::remove_all(scene_.file("kept"));
  std::filesystem::create_directory(scene_.file("kept"));
  ASSERT_TRUE(reloads(*broker, "[access]\nanonymous = \"nowhere\"\n" + keys + trusted));
  const std::string views = text_of(token("views", {"--subscribe", "**"}).substr(1));
  const std::string authorization = "Authorization: Bearer " + views.substr(0, views.find('\n'));
  for (int i = 0; i < 2; ++i) {
    const std::string shown = curl(asset, {"--header", authorization, "--output", "/dev/null", "--dump-header", "-"});
    EXPECT_THAT(shown, HasSubstr("private, max-age=31536000, immutable"));
    EXPECT_THAT(shown, Not(HasSubstr("HIT")));
    EXPECT_THAT(curl(asset, {"--output", "/dev/null", "--dump-header", "-"}), HasSubstr(" 401"));
  }
}

}  // namespace
}  // namespace eigencast::testing
