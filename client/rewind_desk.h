// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "client/viewer_state.h"
#include "view/pose_source.h"
#include "view/scene.h"

namespace eigencast {

/// Moves the streams of a scene together through what their brokers keep of them (Rewind), with the keys of clips. The
/// first stream that has a past leads: it says where they are, and all are sent there. Moments are microseconds since
/// 1970 on its broker's clock; `now_us` is of the steady clock. Not thread-safe.
class RewindDesk {
 public:
  struct Bar {
    std::vector<control::History::Span> spans;  ///< At least one.
    TimeUs now_us = 0, at_us = 0;               ///< The live edge, and what is shown.
    bool is_past = false;                       ///< What is shown does not follow the live edge.
  };
  /// Where the one who leads in a room is.
  struct Led {
    std::optional<TimeUs> at_us;  ///< Nothing: live.
    double speed = 1;             ///< 0: paused.
    bool operator==(const Led&) const = default;
  };

  /// Begins so long before now, once the broker says what it keeps.
  void begin(double ago_s, double speed);
  /// Takes what the user wants from the state, and puts there what has become of it. True: the user wants something.
  bool take(ViewerState& state);
  /// Once a turn, after poll() and before the scene advances.
  void advance(std::span<PoseSource* const> sources, const Scene& scene, TimeUs now_us);

  /// Nothing: no stream has a past.
  const std::optional<Bar>& bar() const { return bar_; }
  /// The moment shown, where it is not live.
  std::optional<TimeUs> past_us() const { return bar_ && bar_->is_past ? std::optional(at_us_) : std::nullopt; }
  /// The picture is to stay as it is: it is paused where it was, between poses too.
  bool holds() const { return holds_; }
  /// Nothing is on its way: what is shown is what was wanted.
  bool is_settled() const { return !begin_ && !wanted_ && !asked_ && steps_ == 0; }
  /// When the first seek was sent that is shown by now, once; nothing: none.
  std::optional<TimeUs> take_sought(std::span<PoseSource* const> sources, const Scene& scene);
  /// Why something was not done; empty: nothing since the last call.
  std::string take_trouble() { return std::exchange(trouble_, {}); }

  /// That begin() went to less long ago than it was to; empty: nothing since the last call.
  std::string take_notice() { return std::exchange(notice_, {}); }

  /// Changes with what the user does, and every two seconds while it plays.
  const Led& led() const { return led_; }
  /// REQUIRES: bar().
  void follow(const Led& led);

 private:
  struct Wanted {
    TimeUs at_us = 0;
    double speed = 1;
    bool next = false;  ///< The first pose after it.
  };
  /// Of the leading stream, before what is not answered yet.
  struct Asked {
    std::uint32_t epoch = 0;
    std::uint64_t refusals = 0;
  };
  struct Motion {
    bool paused = false;
    double speed = 1;
    double told() const { return paused ? 0 : speed; }
  };
  void go(TimeUs at_us);
  void end();
  void hear(const PoseSource& source, const Rewind::Kept& kept, TimeUs now_us);
  void send(std::span<PoseSource* const> sources, const PoseSource& lead, const Rewind::Kept& kept, TimeUs now_us);
  void ask_why(std::span<PoseSource* const> sources, TimeUs now_us);

  std::optional<Bar> bar_;
  bool is_past_ = false, holds_ = false, present_wanted_ = false, asks_why_ = false;
  TimeUs edge_us_ = 0, at_us_ = 0;  ///< Now, and what is shown or soon to be.
  Motion motion_;
  std::optional<Motion> changed_;  ///< To be put into the state.
  std::optional<double> begin_;    ///< Seconds ago.
  std::optional<Wanted> wanted_;
  std::optional<Asked> asked_;
  std::optional<TimeUs> sought_us_;
  int steps_ = 0;  ///< Poses to go on, once there is an answer.
  TimeUs sent_us_ = 0, asked_kept_us_ = 0, led_us_ = 0;
  Led led_;
  std::string trouble_, notice_;
};

}  // namespace eigencast
