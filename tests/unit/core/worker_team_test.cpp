// SPDX-License-Identifier: MIT
#include "common/core/worker_team.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "common/core/machine.h"

namespace eigencast {
namespace {

TEST(WorkerTeam, CallsEachTaskOnce) {
  WorkerTeam team(3);
  for (int loop = 0; loop < 200; ++loop) {
    for (const std::size_t count : {0U, 1U, 2U, 7U, 100U}) {
      std::vector<int> calls(count);
      team.run(count, [&](std::size_t i) { ++calls[i]; });
      EXPECT_EQ(calls, std::vector<int>(count, 1));
    }
  }
}

TEST(WorkerTeam, NestedLoopsRunOnTheirCallersThread) {
  WorkerTeam team(2);
  std::atomic<int> calls = 0;
  team.run(8, [&](std::size_t) {
    const auto here = std::this_thread::get_id();
    team.run(5, [&](std::size_t) {
      EXPECT_EQ(std::this_thread::get_id(), here);
      ++calls;
    });
  });
  EXPECT_EQ(calls, 40);
}

TEST(WorkerTeam, ConcurrentCallersAreServed) {
  WorkerTeam team(2);
  std::atomic<int> calls = 0;
  std::vector<std::thread> callers;
  for (int i = 0; i < 4; ++i) {
    callers.emplace_back([&] {
      for (int loop = 0; loop < 100; ++loop) team.run(10, [&](std::size_t) { ++calls; });
    });
  }
  for (std::thread& caller : callers) caller.join();
  EXPECT_EQ(calls, 4000);
}

TEST(WorkerTeam, SingleThreadIsTheCallers) {
  WorkerTeam team(1);
  team.run(20, [here = std::this_thread::get_id()](std::size_t) { EXPECT_EQ(std::this_thread::get_id(), here); });
}

TEST(WorkerTeam, AForkedProcessRunsLoopsAndEnds) {
  worker_team().run(100, [](std::size_t) {});
  const pid_t child = ::fork();
  if (child == 0) {
    ::alarm(30);  // rather than hang for good
    std::atomic<int> calls = 0;
    worker_team().run(100, [&](std::size_t) { ++calls; });
    std::exit(calls == 100 ? 0 : 1);  // with the destructors of statics
  }
  int status = -1;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status)) << "signal " << WTERMSIG(status);
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

TEST(WorkerTeam, ExceptionsReachTheCallerAfterTheLoop) {
  for (const unsigned threads : {1U, 2U, 4U}) {
    WorkerTeam team(threads);
    for (std::size_t bad = 0; bad < 40; ++bad) {
      std::atomic<int> at_work = 0;
      std::string said;
      try {
        team.run(40, [&](std::size_t i) {
          ++at_work;
          std::this_thread::yield();
          --at_work;
          if (i >= bad) throw std::runtime_error("task");
        });
      } catch (const std::runtime_error& error) {
        said = error.what();
      }
      EXPECT_EQ(said, "task");
      EXPECT_EQ(at_work, 0);
    }
    std::vector<int> calls(40);
    team.run(40, [&](std::size_t i) { ++calls[i]; });
    EXPECT_EQ(calls, std::vector<int>(40, 1)) << "nothing of it is left";
  }
}

TEST(InstructionSets, StartAtTheBaselineAndGrow) {
  const auto& sets = instruction_sets();
  ASSERT_FALSE(sets.empty());
  EXPECT_EQ(sets.front(), InstructionSet::kBaseline);
  for (std::size_t i = 1; i < sets.size(); ++i) EXPECT_LT(sets[i - 1], sets[i]);
}

}  // namespace
}  // namespace eigencast
