// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <memory>

namespace eigencast {

/// Threads that wait to share out loops. One team serves the whole process: see worker_team().
///
/// Thread-safe: a loop that finds the team busy runs on its caller's thread alone, so that nobody waits for another's
/// work and a task may itself start a loop. In a process that was forked loops run on their callers' threads.
class WorkerTeam {
 public:
  /// threads: the caller included; 0 means one for each processor. They start with the first loop that needs them.
  explicit WorkerTeam(unsigned threads = 0);
  ~WorkerTeam();
  WorkerTeam(const WorkerTeam&) = delete;
  WorkerTeam& operator=(const WorkerTeam&) = delete;

  unsigned threads() const;
  /// Calls task(i) once for each i < count, on any of the threads in any order, and returns when all are done. What a
  /// call writes is visible after it. What a task throws ends the loop and leaves run() (of several, the first).
  void run(std::size_t count, const std::function<void(std::size_t)>& task);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The process's team, with a thread for each processor that it may use.
WorkerTeam& worker_team();

/// Calls work(first, end) for shares of `at_once` of the numbers below `count`, as WorkerTeam::run() does.
template <typename Work>
void for_shares(std::size_t count, std::size_t at_once, const Work& work) {
  worker_team().run((count + at_once - 1) / at_once,
                    [&](std::size_t share) { work(share * at_once, std::min(count, (share + 1) * at_once)); });
}
/// Calls work(i) for each of them.
template <typename Work>
void for_each_shared(std::size_t count, std::size_t at_once, const Work& work) {
  for_shares(count, at_once, [&](std::size_t first, std::size_t end) {
    for (std::size_t i = first; i < end; ++i) work(i);
  });
}

}  // namespace eigencast
