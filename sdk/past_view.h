// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "common/core/result.h"
#include "sdk/subscriber.h"

namespace eigencast {

/// The past of a stream for callers that wait for poses: after seek() they get those of that time, or hear why not,
/// however long that takes and whatever becomes of the connection. Time comes in as arguments, of the steady clock. Not
/// thread-safe.
class PastView {
 public:
  /// Until the broker answers it is asked again after so long.
  static constexpr TimeUs kAnswerUs = 3'000'000;

  /// at_us: microseconds since 1970 on the broker's clock; negative: so long before it gets there. speed: 0 (that pose
  /// alone), or 0.1 to 10. next: the first pose after that time. Errors: kInvalidArgument.
  Result<void> seek(TimeUs at_us, double speed, bool next);
  void show_present();
  /// Once after each poll(): says to the broker what it is to hear. Errors: kRefused: a seek was not done, and what was
  /// shown goes on.
  Result<void> advance(Subscriber& subscriber, TimeUs now_us);
  /// What was sought has not begun yet: poses are of before.
  bool waits() const { return wanted_.has_value(); }
  /// A pose of that epoch is what was sought, or followed that.
  bool is_wanted(std::uint32_t epoch, const Subscriber& subscriber);
  /// What is kept, asked for once a second; nothing: the broker has not said.
  std::optional<Rewind::Kept> kept(Subscriber& subscriber, TimeUs now_us);

 private:
  struct Wanted {
    bool present = false;
    TimeUs at_us = 0;
    double speed = 1;
    bool next = false;
  };
  struct Asked {
    TimeUs at_us = 0;  ///< On the steady clock.
    std::uint32_t epoch = 0;
    std::uint64_t refusals = 0, reconnects = 0;
  };
  Result<void> hear(Subscriber& subscriber);

  std::optional<Wanted> wanted_;
  std::optional<Asked> asked_;
  std::optional<std::uint32_t> begins_;  ///< The epoch of what was sought, until a pose of it has come.
  std::optional<TimeUs> asked_kept_us_;
};

}  // namespace eigencast
