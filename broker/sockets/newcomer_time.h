// SPDX-License-Identifier: MIT
#pragma once

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

  /// True: go on with what takes about `us`. Else `then` is called when its turn has come, after `wait_us` at least.
  bool take(const std::string& holder, double us, TimeUs wait_us, std::function<void()> then);

 private:
  struct Work {
    std::string holder;
    double us;
    std::function<void()> then;
  };
  bool is_free(TimeUs now_us) const;
  void wait(Work work);
  void arm();
  void serve();

  std::multimap<TimeUs, Work> later_;  ///< By the time from which on they wait for their turns.
  FairQueue<Work> waiting_;
  double paid_until_us_ = 0;
  Timer timer_;
  TimeUs armed_us_ = 0;  ///< 0: the timer is not.
};

}  // namespace eigencast::broker
