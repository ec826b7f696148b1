// SPDX-License-Identifier: MIT
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "tests/system/operation.h"

// What the tests of access, TLS and proxies share: secrets, certificates, tokens, clients that are let in or not.
namespace eigencast::testing {

inline void write_secret(const std::string& path, const std::string& text) {
  std::ofstream(path) << text;
  chmod(path.c_str(), 0600);
}

/// A self-signed certificate for localhost and 127.0.0.1, or others, as NAME.pem and NAME.key; false without the
/// openssl program.
inline bool make_certificate(const Scene& scene, const std::string& name,
                             const std::string& hosts = "DNS:localhost,IP:127.0.0.1") {
  if (!on_path("openssl")) return false;
  Process openssl({"openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days",
                   "30", "-subj", "/CN=" + name, "-addext", "subjectAltName=" + hosts, "-keyout",
                   scene.file(name + ".key"), "-out", scene.file(name + ".pem")},
                  scene.file("openssl.log"));
  const bool made = openssl.wait(kPatience) == 0;
  chmod(scene.file(name + ".key").c_str(), 0600);
  return made;
}

class AccessTest : public Operation {
 protected:
  void SetUp() override {
    write_secret(scene_.file("main.secret"), "a secret of the tests, of more than 32 bytes");
    std::ofstream(scene_.file("eigencast.toml"))
        << "[access]\nanonymous = \"nowhere\"\njwt_leeway_s = 0\njwt_keys = [\"main HS256 "
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
                                 "--subject",        name};
    all.insert(all.end(), rights.begin(), rights.end());
    std::filesystem::remove(scene_.file(name + ".log"));
    EXPECT_EQ(scene_.run(name, all), 0) << text_of(scene_.file(name + ".log"));
    write_secret(scene_.file(name), text_of(scene_.file(name + ".log")));
    std::filesystem::remove(scene_.file(name + ".log"));
    return "@" + scene_.file(name);
  }
  /// Whether a client got poses.
  bool watches(const std::string& name, std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--frames", "5", "--wait", "50"});
    auto client = scene_.start_client(name, arguments);
    const bool good = client->wait(kPatience) == 0;
    return good && scene_.received(name).size() >= 5;
  }
  /// What a client that is not let in says; where that is final at once: nobody waits an hour for it.
  std::string refusal(const std::string& name, std::vector<std::string> arguments, const char* wait_s = "3600") {
    arguments.insert(arguments.end(), {"--frames", "5", "--wait", wait_s});
    auto client = scene_.start_client(name, arguments);
    EXPECT_EQ(client->wait(kPatience), 4) << client->output();
    return client->output();
  }
  /// Has the broker read its configuration again; whether it took it.
  bool reloads(Process& broker) {
    const auto taken = [&] { return metric("eigencast_broker_reloads_total"); };
    const auto refused = [&] { return metric("eigencast_broker_reloads_failed_total"); };
    const double taken_before = taken(), refused_before = refused();
    broker.signal(SIGHUP);
    EXPECT_TRUE(eventually([&] { return taken() > taken_before || refused() > refused_before; }, kPatience))
        << scene_.logs();
    return taken() > taken_before;
  }
};

}  // namespace eigencast::testing
