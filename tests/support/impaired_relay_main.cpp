// SPDX-License-Identifier: MIT
// eigencast-impaired-relay: the relay of impaired_relay.h as a process, for scripts and system tests.

#include <signal.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <map>

#include "tests/support/impaired_relay.h"

using eigencast::testing::ImpairedRelay;
using eigencast::testing::Impairment;

namespace {

/// The links that the project's figures are taken on.
const std::map<std::string, Impairment>& known_links() {
  static const std::map<std::string, Impairment> links = [] {
    std::map<std::string, Impairment> l;
    l["none"] = {};
    l["wlan"] = {.delay_us = 20'000, .jitter_us = 5'000};
    l["wan"] = {.delay_us = 150'000, .jitter_us = 50'000, .loss = 0.05};
    l["3g"] = {.delay_us = 100'000, .rate_bit_per_s = 2e6};
    l["thin"] = {.rate_bit_per_s = 5e5};
    return l;
  }();
  return links;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "A TCP relay on loopback that behaves like a bad link. Runs until SIGTERM or SIGINT.\n"
      "  eigencast-impaired-relay --to 7490 --link wan --port-file port\n"};
  std::string link = "none", port_file, direction = "both";
  std::uint16_t to = 0, port = 0;
  double delay_ms = -1, jitter_ms = -1, rate_kbit = -1, loss_percent = -1, retransmit_ms = -1, stall_every_ms = 0,
         stall_ms = 0;
  std::uint64_t seed = 1;
  app.add_option("--to", to, "port of the target on 127.0.0.1")->required();
  app.add_option("--port", port, "port to listen on (default: any free one)");
  app.add_option("--port-file", port_file, "the port is written here once it listens");
  app.add_option("--link", link,
                 "none, wlan (20 +- 5 ms), wan (150 +- 50 ms, 5 % loss), 3g (2 Mbit/s, 100 ms), thin (500 kbit/s)");
  app.add_option("--delay-ms", delay_ms, "added each way");
  app.add_option("--jitter-ms", jitter_ms, "the delay is uniform in delay +- jitter");
  app.add_option("--rate-kbit", rate_kbit, "kbit/s each way, shared by all connections");
  app.add_option("--loss-percent", loss_percent, "segments that TCP must send again");
  app.add_option("--retransmit-ms", retransmit_ms, "how long that takes (default: 200 ms + 2 delay)");
  app.add_option("--stall-every-ms", stall_every_ms, "the link stops once in this time");
  app.add_option("--stall-ms", stall_ms, "and for so long");
  app.add_option("--direction", direction, "what is impaired: both (default), down (from the target), up")
      ->check(CLI::IsMember({"both", "down", "up"}));
  app.add_option("--seed", seed, "the same seed gives the same link");
  CLI11_PARSE(app, argc, argv);

  const auto known = known_links().find(link);
  if (known == known_links().end()) {
    std::fprintf(stderr, "--link %s: none, wlan, wan, 3g, thin are known\n", link.c_str());
    return 2;
  }
  Impairment i = known->second;
  const auto us = [](double ms) { return static_cast<eigencast::TimeUs>(ms * 1000); };
  if (delay_ms >= 0) i.delay_us = us(delay_ms);
  if (jitter_ms >= 0) i.jitter_us = us(jitter_ms);
  if (rate_kbit >= 0) i.rate_bit_per_s = rate_kbit * 1000;
  if (loss_percent >= 0) i.loss = loss_percent / 100;
  if (retransmit_ms >= 0) i.retransmit_us = us(retransmit_ms);
  i.stall_every_us = us(stall_every_ms);
  i.stall_us = us(stall_ms);

  ImpairedRelay::Options options;
  options.target_port = to;
  options.port = port;
  if (direction != "down") options.to_target = i;
  if (direction != "up") options.from_target = i;
  options.to_target.seed = seed;
  options.from_target.seed = seed + 1;

  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGTERM);
  sigaddset(&ends, SIGINT);
  pthread_sigmask(SIG_BLOCK, &ends, nullptr);  // Before the relay's thread, which inherits it.
  signal(SIGPIPE, SIG_IGN);
  auto relay = ImpairedRelay::start(options);
  if (!relay) {
    std::fprintf(stderr, "%s\n", relay.error().message.c_str());
    return 1;
  }
  std::printf("listening on 127.0.0.1:%u\n", unsigned{(*relay)->port()});
  std::fflush(stdout);
  if (!port_file.empty()) {
    std::ofstream(port_file + ".new") << (*relay)->port() << "\n";
    std::rename((port_file + ".new").c_str(), port_file.c_str());
  }
  int got = 0;
  sigwait(&ends, &got);
  return 0;
}
