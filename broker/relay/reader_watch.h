// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Whether a viewer that never acknowledges still reads, decided from its TCP window and from its pongs.
///
/// What the peer's kernel holds unread narrows the window that it offers. Who offers less than before is asked by a
/// WebSocket ping, which every client answers once it has read what came before it (RFC 6455, 5.5.2). While the answer
/// is overdue, frames are to wait, so that it gets the present pose when it wakes and no backlog.
///
/// Time comes in as an argument. Not thread-safe.
class ReaderWatch {
 public:
  static constexpr TimeUs kNever = std::numeric_limits<TimeUs>::max();

  /// Those of different `phase` look after different frames: who came one after the other do not all look in one turn.
  explicit ReaderWatch(std::uint64_t phase = 0) : sent_(static_cast<std::uint32_t>(phase % kFramesBetweenLooks)) {}

  /// A frame left; true: look at the window now.
  bool note_sent() { return ++sent_ % kFramesBetweenLooks == 0; }

  /// The window that the peer offers; true: ask it, with question().
  bool note_window(std::uint32_t bytes, TimeUs round_trip_us, TimeUs now_us);

  /// A pong came; true: it answers the question, all that was sent before has been read.
  bool note_pong(std::string_view payload);

  /// Payload of the ping.
  std::string question() const { return std::to_string(question_); }
  bool is_asking() const { return hold_from_us_ != kNever; }
  /// From when on frames are to wait.
  TimeUs hold_from_us() const { return hold_from_us_; }

 private:
  /// Looking is a system call: one for so many frames is lost among theirs.
  static constexpr std::uint32_t kFramesBetweenLooks = 32;

  TimeUs hold_from_us_ = kNever;
  std::uint32_t sent_;
  std::uint32_t widest_ = 0;  ///< Bytes; of late.
  std::uint32_t latest_ = 0;
  std::uint32_t question_ = 0;
};

}  // namespace eigencast::broker
