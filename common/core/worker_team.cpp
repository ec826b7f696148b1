// SPDX-License-Identifier: MIT
#include "common/core/worker_team.h"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace eigencast {

struct WorkerTeam::State {
  std::atomic<unsigned> threads = 1;
  const pid_t process = ::getpid();
  std::atomic_flag busy;  // set while a loop runs; not a mutex, since a task may ask on the thread that set it

  std::mutex mutex;  // guards what follows
  std::condition_variable changed;
  const std::function<void(std::size_t)>* task = nullptr;
  std::size_t count = 0;
  std::uint64_t loop = 0;
  unsigned working = 0;
  std::exception_ptr failure;  // of the first task that threw
  bool stopping = false;

  std::atomic<std::size_t> next = 0;

  std::vector<std::thread> workers;  // last: they use the rest

  /// A forked process has of the threads no more than their memory, in the state of that moment.
  bool is_elsewhere() const { return ::getpid() != process; }

  void take_tasks(const std::function<void(std::size_t)>& call, std::size_t until) {
    try {
      for (std::size_t i = next.fetch_add(1); i < until; i = next.fetch_add(1)) call(i);
    } catch (...) {
      next = until;
      const std::lock_guard lock(mutex);
      if (!failure) failure = std::current_exception();
    }
  }

  void work() {
    std::uint64_t seen = 0;
    std::unique_lock lock(mutex);
    for (;;) {
      changed.wait(lock, [&] { return stopping || (task != nullptr && loop != seen); });
      if (stopping) return;
      seen = loop;
      ++working;
      const auto& call = *task;
      const std::size_t until = count;
      lock.unlock();
      take_tasks(call, until);
      lock.lock();
      if (--working == 0) changed.notify_all();
    }
  }

  void start() {
    try {
      while (workers.size() + 1 < threads) workers.emplace_back([this] { work(); });
    } catch (const std::system_error&) {
      threads = static_cast<unsigned>(workers.size()) + 1;  // as many as the system grants
    }
  }
};

WorkerTeam::WorkerTeam(unsigned threads) : state_(std::make_unique<State>()) {
  state_->threads = threads > 0 ? threads : std::max(1U, std::thread::hardware_concurrency());
}

WorkerTeam::~WorkerTeam() {
  if (state_->is_elsewhere()) {
    (void)state_.release();
    return;
  }
  {
    const std::lock_guard lock(state_->mutex);
    state_->stopping = true;
  }
  state_->changed.notify_all();
  for (std::thread& worker : state_->workers) worker.join();
}

unsigned WorkerTeam::threads() const {
  return state_->threads;
}

void WorkerTeam::run(std::size_t count, const std::function<void(std::size_t)>& task) {
  State& state = *state_;
  if (count < 2 || state.threads < 2 || state.is_elsewhere() || state.busy.test_and_set()) {
    for (std::size_t i = 0; i < count; ++i) task(i);
    return;
  }
  if (state.workers.empty()) state.start();
  {
    const std::lock_guard lock(state.mutex);
    state.task = &task;
    state.count = count;
    state.next = 0;
    ++state.loop;
  }
  state.changed.notify_all();
  state.take_tasks(task, count);
  std::unique_lock lock(state.mutex);
  state.task = nullptr;  // a worker that wakes up late finds nothing
  state.changed.wait(lock, [&] { return state.working == 0; });
  const std::exception_ptr failure = std::exchange(state.failure, nullptr);
  state.busy.clear();
  lock.unlock();
  if (failure) std::rethrow_exception(failure);
}

WorkerTeam& worker_team() {
  static WorkerTeam team;
  return team;
}

}  // namespace eigencast
