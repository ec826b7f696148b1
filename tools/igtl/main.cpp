// SPDX-License-Identifier: MIT
#include <signal.h>

#include <atomic>
#include <cstdio>

#include "common/command_line/log.h"
#include "tools/igtl/options.h"

namespace {

std::atomic<bool> stop_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);

}  // namespace

int main(int argc, char** argv) {
  using namespace eigencast;
  const auto options = igtl::options_from_command_line(argc, argv, EIGENCAST_VERSION);
  if (const auto* now = std::get_if<ExitNow>(&options)) return now->code;
  struct sigaction action {};
  action.sa_handler = [](int) { stop_requested = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  const auto ran =
      igtl::run_bridge(std::get<igtl::Options>(options), stop_requested, sink_to(stderr_logger(LogLevel::kInfo)));
  if (ran) return igtl::kExitGood;
  std::fprintf(stderr, "eigencast-igtl: %s\n", ran.error().message.c_str());
  return ran.error().code == ErrorCode::kInvalidArgument ? igtl::kExitUsage : igtl::kExitFailed;
}
