// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/post.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <mutex>
#include <string>
#include <utility>

#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// Threads for calls that block on the disk, holders in fair turns. Thread-safe.
class DiskThreads {
 public:
  using Work = std::function<void()>;

  explicit DiskThreads(std::size_t threads) : pool_(threads) {}

  /// `work` must not throw. holder: who waits for it; empty: the broker.
  void post(const std::string& holder, Work work) {
    {
      const std::lock_guard lock(mutex_);
      waiting_.push(holder, 1, std::move(work));
    }
    boost::asio::post(pool_, [this] { next()(); });
  }
  /// Until all is done.
  void join() { pool_.join(); }
  boost::asio::thread_pool& pool() { return pool_; }

 private:
  Work next() {
    const std::lock_guard lock(mutex_);
    return waiting_.pop().item;
  }

  std::mutex mutex_;
  FairQueue<Work> waiting_;  ///< GUARDED_BY(mutex_)
  boost::asio::thread_pool pool_;
};

}  // namespace eigencast::broker
