// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>

#include "broker/access/gate.h"
#include "common/core/clock.h"

namespace eigencast::broker {

/// What the messages of other brokers may make the event loop do, by estimates. Not thread-safe.
class PeerWork {
 public:
  static constexpr double kRowsUsPerS = 250'000;  ///< Of a broker's name: as much as a token's messages by default.
  /// Of a broker's name in each period: twice as much. One of its senders has half of that, or, when all together asked
  /// for more in the period before, what is fair (max-min), a newcomer counted in.
  static constexpr std::int64_t kFramesUs = 125'000;
  static constexpr TimeUs kPeriodUs = 250'000;
  /// Of changes, in shorter periods, as all of them may come at once.
  static constexpr std::int64_t kChangesUs = 12'500;
  static constexpr TimeUs kChangesPeriodUs = 25'000;
  static constexpr std::size_t kMaxNames = 1'024;  ///< Those that are over nothing are forgotten first.

  /// False: over the limit, drop the message. `broker`: its id.
  bool take_row(std::string_view broker, double work_us, TimeUs now_us);
  bool take_frame(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us);
  /// What frames took that were let in, besides.
  void charge_frames(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us);
  /// For changes of streams, of which viewers here are told. What the last one takes beyond the limit counts in the
  /// periods to come. False: over the limit, try again later.
  bool take_change(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us);

 private:
  struct Limit {
    std::int64_t all_us;  ///< Of a broker; a sender has half of it at most.
    TimeUs period_us;
  };
  struct Work {
    TimeUs since_us = 0;
    std::int64_t used_us = 0, most_us = 0;  ///< Of a sender.
    struct Sender {
      std::int64_t used_us = 0, asked_us = 0;
    };
    std::map<std::string, Sender> senders;
  };
  using WorkByBroker = std::map<std::string, Work, std::less<>>;
  static constexpr Limit kFrameLimit{kFramesUs, kPeriodUs}, kChangeLimit{kChangesUs, kChangesPeriodUs};
  /// In the present period. Null: too many are in use.
  static Work* work_of(WorkByBroker& all, const Limit& limit, std::string_view broker, TimeUs now_us);
  static std::int64_t fair_share(const Work& before, const Limit& limit);

  std::map<std::string, RateLimiter, std::less<>> rows_;  ///< By name of brokers.
  WorkByBroker frames_, changes_;                         ///< Likewise.
};

}  // namespace eigencast::broker
