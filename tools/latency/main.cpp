// SPDX-License-Identifier: MIT
#include <signal.h>

#include <atomic>
#include <cstdlib>

#include "tools/latency/commands.h"

namespace {

std::atomic<bool> stop_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);

}  // namespace

int main(int argc, char** argv) {
  using namespace eigencast::latency;
  const auto options = options_from_command_line(argc, argv, EIGENCAST_VERSION);
  if (const auto* now = std::get_if<eigencast::ExitNow>(&options)) return now->code;
  ::unsetenv("EIGENCAST_TOKEN");  // Read above; a broker of our own must not get it.
  struct sigaction action {};
  action.sa_handler = [](int) { stop_requested = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  signal(SIGPIPE, SIG_IGN);
  return run_command(std::get<Options>(options), EIGENCAST_VERSION, stop_requested);
}
