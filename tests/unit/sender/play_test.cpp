// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include "sender/commands.h"
#include "tests/support/process.h"

namespace eigencast {
namespace {

TEST(Play, EndsWhenItsDurationIsOverThoughNoBrokerCame) {
  testing::TemporaryFolder folder;
  PlayCommand command;
  command.source.input = "sphere";
  command.source.rank = 8;
  command.source.cache_dir = folder.file("cache");
  command.target.url = "ws://127.0.0.1:1/a";  // Where nobody listens.
  command.duration_s = 0.3;
  Interrupt interrupt;
  const TimeUs start = steady_now_us();
  EXPECT_EQ(run(command, Console{.progress = false}, interrupt), kExitUnreachable);
  EXPECT_GE(steady_now_us() - start, 300'000);
}

}  // namespace
}  // namespace eigencast
