// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "common/core/clock.h"

namespace eigencast::broker {

/// Decides from TCP window and pongs whether a viewer that never acknowledges still reads.
/// Unread bytes in the peer's kernel narrow the window that it offers. A peer whose window narrowed is probed with a
/// WebSocket ping, which a client answers once it has read everything before it (RFC 6455, 5.5.2). While the pong is
/// overdue, frames wait, so that the viewer gets the current pose when it resumes and no backlog.
/// A kernel may tell of a frame that has come, and not that it was read: then the acknowledgement of a ping soon shows
/// the wide window, and that much narrowing means nothing from then on. Or it never widens the window again, after
/// larger frames: what it offers then counts as wide in time, later each time, if the peer never sent a pong.
/// Not thread-safe.
class ReaderWatch {
 public:
  static constexpr TimeUs kNever = std::numeric_limits<TimeUs>::max();

  /// Different phases check after different frames, so that not all connections check in the same turn.
  explicit ReaderWatch(std::uint64_t phase = 0) : sent_(static_cast<std::uint32_t>(phase % kFramesBetweenChecks)) {}

  /// A frame was written; true: check the window now.
  bool note_sent() { return ++sent_ % kFramesBetweenChecks == 0; }

  /// `bytes`: that the peer offers. True: send a ping with probe().
  bool note_window(std::uint32_t bytes, TimeUs round_trip_us, TimeUs now_us);
  /// Frames wait: whether to check the window now.
  bool is_check_due(TimeUs now_us) const { return is_probing() && now_us >= check_us_; }

  /// True: it answers the probe, so everything sent before it has been read.
  bool note_pong(std::string_view payload);

  std::string probe() const { return std::to_string(probe_); }
  bool is_probing() const { return hold_from_us_ != kNever; }
  TimeUs hold_from_us() const { return hold_from_us_; }

 private:
  static constexpr std::uint32_t kFramesBetweenChecks = 32;  ///< A check is a system call.
  /// A few poses that the peer has yet to read narrow its window by less.
  static constexpr std::uint32_t kNarrowedBytes = 2048;

  TimeUs hold_from_us_ = kNever;
  TimeUs check_us_ = 0, ask_us_ = 0, end_us_ = 0;  ///< While it is probing: when to do so again, and to end that.
  TimeUs patience_us_ = 5'000'000;                 ///< Until the next end of that kind.
  bool answers_ = false;                           ///< It has sent a pong.
  std::uint32_t sent_;
  std::uint32_t widest_ = 0;  ///< Bytes; recent maximum.
  std::uint32_t latest_ = 0;
  std::uint32_t narrowed_ = 0;            ///< While it is probing: by so many bytes, at most.
  std::uint32_t slack_ = kNarrowedBytes;  ///< Narrowing by less means nothing.
  std::uint32_t probe_ = 0;
};

}  // namespace eigencast::broker
