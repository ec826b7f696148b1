// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <string>

#include "broker/sockets/net.h"
#include "common/core/clock.h"
#include "common/core/fair_queue.h"

namespace eigencast::broker {

/// What HTTP and TLS handshakes take of an event loop's time: at most half, by estimates, so that streams keep theirs,
/// in fair turns of holders. Belongs to its loop.
class NewcomerTime {
 public:
  explicit NewcomerTime(asio::io_context& loop) : timer_(loop.get_executor()) {}

  /// What a turn needs beside time, such as memory: it has it, has to wait for it, or is not wanted any more.
  enum class Supply : std::uint8_t { kHeld, kShort, kGone };
  using Hold = std::function<Supply()>;

  /// True: go on with what takes about `us`. Else `then` is called when its turn has come, after `wait_us` at least,
  /// and once `hold` holds what it needs. Who is short of that is asked again some 50 ms later, one of each holder.
  bool take(const std::string& holder, double us, TimeUs wait_us, std::function<void()> then, Hold hold = {});

 private:
  struct Work {
    std::string holder;
    double us;
    std::function<void()> then;
    Hold hold;
  };
  bool is_free(TimeUs now_us) const;
  void pay(double us, TimeUs now_us);
  bool is_supplied(Work& work, TimeUs now_us);
  void supply();
  void wait(Work work);
  void arm();
  void serve();

  std::multimap<TimeUs, Work> later_;  ///< By the time from which on they wait for their turns.
  std::map<std::string, std::deque<Work>> short_;  ///< Of what they need, by holder.
  std::string supplied_;                           ///< The holder who was asked last.
  TimeUs supply_at_us_ = 0;
  FairQueue<Work> waiting_;
  double paid_until_us_ = 0;
  Timer timer_;
  TimeUs armed_us_ = 0;  ///< 0: the timer is not.
};

}  // namespace eigencast::broker
