// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>

#include "broker/relay/shares.h"
#include "common/core/clock.h"

namespace eigencast::broker {

/// Which moment viewers show that want to show the same one. A lag is a time on the broker's clock minus the capture
/// time of the pose that arrives, or is shown, then. Each viewer says which lag it needs so that poses are there in
/// time. A group of streams has one delay behind the fastest arrivals of each of them here: that of the viewer that
/// needs most, up to a bound, which is all that a false one can do; of crowds kMaxWaitedFor are asked. Changes run at
/// 1 / kSlew of the time that passes, so that viewers, who can follow that, show the same meanwhile. Time comes in as
/// arguments. Thread-safe.
class Moments {
 public:
  static constexpr TimeUs kSlew = 25;              ///< 4 %; playout follows 5 %.
  static constexpr TimeUs kWindowUs = 3'000'000;   ///< The fastest arrival is that of so long, at least.
  static constexpr TimeUs kForgetUs = 10'000'000;  ///< What a viewer said longer ago does not count.
  static constexpr TimeUs kRefreshUs = 200'000;    ///< The delay is found anew so often.
  static constexpr TimeUs kStrayUs = 1'000'000;    ///< Beyond it, as where a sender's clock was set, a lag jumps.
  static constexpr std::int64_t kMaxWaitedFor = 1024;  ///< Viewers of a group, by shares of holders.
  using Seat = std::uint64_t;

  Seat join(const std::string& group, const std::string& stream);
  void leave(Seat seat);
  /// A key of the seat's stream.
  void note_arrival(Seat seat, TimeUs lag_us, TimeUs now_us);
  /// Ignored if its holder has its share of those who are waited for.
  void report(Seat seat, const std::string& holder, TimeUs needed_lag_us, TimeUs now_us);
  /// That with which the seat's stream is to be shown now; nothing: nothing has arrived yet.
  std::optional<TimeUs> lag_us(Seat seat, TimeUs now_us, TimeUs max_delay_us);
  /// So much of it is behind the fastest arrivals of the seat's stream.
  TimeUs delay_us(Seat seat);

 private:
  struct Stream {
    std::size_t viewers = 0;
    std::optional<TimeUs> fastest_us, before_us;  ///< Of this window and the one before.
    TimeUs window_us = 0;                         ///< When it began.
    std::optional<TimeUs> shown_us, goal_us;      ///< Its lag now, and what it goes to.
    TimeUs at_us = 0;
    std::optional<TimeUs> fastest() const;
    void advance(TimeUs now_us);  ///< REQUIRES: goal_us.
  };
  using Streams = std::map<std::string, Stream>;
  struct WaitedFor {
    const Stream* stream = nullptr;
    TimeUs needs_us = 0;  ///< Its lag.
    TimeUs said_us = 0;
    std::shared_ptr<void> place;
  };
  struct Group {
    Streams streams;
    std::size_t viewers = 0;
    Shares places;
    std::unordered_map<Seat, WaitedFor> waited_for;
    std::optional<TimeUs> refreshed_us;
    TimeUs delay_us = 0;
  };
  using Groups = std::map<std::string, Group>;
  struct Viewer {
    Groups::iterator group;
    Streams::iterator stream;
  };
  static void refresh(Group& group, TimeUs now_us, TimeUs max_delay_us);

  std::mutex mutex_;
  Groups groups_;                             ///< GUARDED_BY(mutex_)
  std::unordered_map<Seat, Viewer> viewers_;  ///< GUARDED_BY(mutex_)
  Seat last_ = 0;                             ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
