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
  static constexpr std::size_t kMaxNames = 1'024;  ///< Those that are over nothing are forgotten first.

  /// False: over the limit, drop the message. `broker`: its id.
  bool take_row(std::string_view broker, double work_us, TimeUs now_us);
  bool take_frame(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us);

 private:
  struct Frames {
    TimeUs since_us = 0;
    std::int64_t used_us = 0, most_us = kFramesUs / 2;  ///< Of a sender.
    struct Sender {
      std::int64_t used_us = 0, asked_us = 0;
    };
    std::map<std::string, Sender> senders;
  };
  static std::int64_t fair_share(const Frames& before);

  std::map<std::string, RateLimiter, std::less<>> rows_;  ///< By name of brokers.
  std::map<std::string, Frames, std::less<>> frames_;     ///< Likewise.
};

}  // namespace eigencast::broker
