// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <utility>

#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// What is to be read from the disk: one at a time, holders in fair turns, as one may take a thread for a second that
/// others need. Belongs to one loop.
class FairReads {
 public:
  using Work = std::function<void()>;
  struct Read {
    std::function<bool()> wanted;  ///< Asked when its turn comes; false: it is dropped.
    Work load;                     ///< Where it may block; must not throw.
    Work then;                     ///< On the loop.
  };

  /// on_disk  runs work where it may block; all of it ends before this does
  /// on_loop  runs work on the loop; thread-safe
  FairReads(std::function<void(Work)> on_disk, std::function<void(Work)> on_loop)
      : on_disk_(std::move(on_disk)), on_loop_(std::move(on_loop)) {}

  /// False: its holder has its share of what may wait; one without a name is spared.
  bool push(const std::string& holder, Read read) {
    if (!waiting_.push(holder, 1, std::move(read), kMaxWaiting)) return false;
    next();
    return true;
  }

 private:
  static constexpr std::int64_t kMaxWaiting = 1024;
  void next() {
    while (!busy_ && !waiting_.empty()) {
      Read read = waiting_.pop().item;
      if (!read.wanted()) continue;
      busy_ = true;
      on_disk_([this, read = std::move(read)]() mutable {
        read.load();
        // What it holds must not end on the disk's thread.
        on_loop_([this, read = std::move(read)] {
          busy_ = false;
          next();
          read.then();
        });
      });
    }
  }

  std::function<void(Work)> on_disk_, on_loop_;
  FairQueue<Read> waiting_;
  bool busy_ = false;
};

}  // namespace eigencast::broker
