// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <utility>

#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// Memories of poses that are to be read: one at a time, holders in fair turns, as one may take a thread of the disk
/// for a second, and downloads need these. Belongs to the first loop.
class MemoryReads {
 public:
  /// Begins, and calls `done` later, on the loop. False: nobody wants it any more.
  using Read = std::function<bool(std::function<void()> done)>;

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
      busy_ = waiting_.pop().item([this] {
        busy_ = false;
        next();
      });
    }
  }

  FairQueue<Read> waiting_;
  bool busy_ = false;
};

}  // namespace eigencast::broker
