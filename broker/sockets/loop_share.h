// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <deque>
#include <functional>
#include <map>
#include <string>

#include "broker/sockets/net.h"
#include "common/core/clock.h"
#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// Work that takes at most half of an event loop's time, in fair turns of holders. One at a time: streams come between.
/// Belongs to its loop.
class LoopShare {
 public:
  explicit LoopShare(asio::io_context& loop) : timer_(loop.get_executor()) {}

  /// What a turn needs beside time, such as memory: it has it, has to wait for it, or is not wanted any more.
  enum class Supply : std::uint8_t { kHeld, kShort, kGone };
  using Hold = std::function<Supply()>;

  /// True: go on with what takes about `us`. Else `then` is called when its turn has come, after `wait_us` at least,
  /// and once `hold` holds what it needs. Who is short of that is asked again some 50 ms later, one of each holder.
  bool take(const std::string& holder, double us, TimeUs wait_us, std::function<void()> then, Hold hold = {});

  /// Whether nobody waits, and there is time: who asks often and takes little need not take() before.
  bool is_free(TimeUs now_us) const { return waiting_.empty() && has_time(now_us); }
  /// Pays for what took so long; less than nothing: what was taken and not used.
  void pay(double us, TimeUs now_us) {
    paid_until_us_ = std::max(paid_until_us_, static_cast<double>(now_us)) + us / kPart;
  }

 private:
  static constexpr double kPart = 0.5;        ///< Of the loop's time.
  static constexpr double kAtOnceUs = 5'000;  ///< Taken ahead of it after a rest.

  bool has_time(TimeUs now_us) const { return paid_until_us_ <= static_cast<double>(now_us) + kAtOnceUs; }
  struct Work {
    std::string holder;
    double us;
    std::function<void()> then;
    Hold hold;
  };
  bool is_supplied(Work& work, TimeUs now_us);
  void supply();
  void wait(Work work);
  void arm();
  void serve();

  std::multimap<TimeUs, Work> later_;              ///< By the time from which on they wait for their turns.
  std::map<std::string, std::deque<Work>> short_;  ///< Of what they need, by holder.
  std::string supplied_;                           ///< The holder who was asked last.
  TimeUs supply_at_us_ = 0;
  FairQueue<Work> waiting_;
  double paid_until_us_ = 0;
  Timer timer_;
  TimeUs armed_us_ = 0;  ///< 0: the timer is not.
};

}  // namespace eigencast::broker
