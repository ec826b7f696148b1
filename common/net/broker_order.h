// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstddef>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Which of several brokers a client tries next, and when: in the order given, round and round. Each has a back-off of
/// its own, so that a client that lost one goes on at the next at once. Not thread-safe.
class BrokerOrder {
 public:
  using Milliseconds = std::chrono::milliseconds;

  /// REQUIRES: brokers >= 1
  explicit BrokerOrder(std::size_t brokers) : tried_(brokers) {}

  std::size_t broker() const { return broker_; }  ///< To be tried now.
  /// The connection was good: what failed before counts no more.
  void forgive() {
    for (Tried& tried : tried_) tried.failures = 0;
  }
  /// Counts a failure of broker(). Returns how many there are in a row.
  int count_failure() { return ++tried_[broker_].failures; }
  /// Goes on to the next that may be tried, else to the one whose time comes first. Returns how long to wait for it.
  ///   pause  before the one that failed last is tried again
  ///   step   before another one is tried
  Milliseconds go_on(TimeUs now_us, Milliseconds pause, Milliseconds step) {
    tried_[broker_].not_before_us = now_us + TimeUs{pause.count()} * 1000;
    const TimeUs soon_us = now_us + TimeUs{step.count()} * 1000;
    std::size_t next = broker_;
    for (std::size_t i = 1; i <= tried_.size(); ++i) {
      const std::size_t other = (broker_ + i) % tried_.size();
      if (i == 1 || tried_[other].not_before_us < tried_[next].not_before_us) next = other;
      if (other != broker_ && tried_[other].not_before_us <= soon_us) {
        broker_ = other;
        return step;
      }
    }
    broker_ = next;
    return Milliseconds((tried_[next].not_before_us - now_us) / 1000);
  }

 private:
  struct Tried {
    int failures = 0;
    TimeUs not_before_us = 0;
  };
  std::vector<Tried> tried_;
  std::size_t broker_ = 0;
};

}  // namespace eigencast
