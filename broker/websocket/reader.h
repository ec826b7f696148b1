// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

#include "broker/websocket/protocol.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"

namespace eigencast::broker::websocket {

/// Validates UTF-8 that comes in pieces, up to the first invalid byte (RFC 3629, section 4).
class Utf8Check {
 public:
  /// REQUIRES: no earlier call returned false.
  [[nodiscard]] bool add(ByteView bytes);
  bool is_whole() const { return remaining_ == 0; }

 private:
  bool lead(std::uint8_t byte);

  std::uint8_t remaining_ = 0;  ///< Continuation bytes to come.
  std::uint8_t min_ = 0x80;
  std::uint8_t max_ = 0xbf;  ///< Range of the next byte: min_ to max_.
};

/// Parses a client's byte stream into messages, strictly by RFC 6455. Bytes come in pieces of any size; an invalid
/// stream is refused at its first invalid byte. A message that is complete in one piece is not copied; an incomplete
/// one is, without allocating ahead, so that an idle reader holds no memory. Safe on hostile input. Not thread-safe.
class MessageReader {
 public:
  struct Limits {
    std::size_t max_text = 65'536;       ///< Bytes of a whole text message.
    std::size_t max_binary = 1'048'576;  ///< Bytes of a whole binary message.
  };
  struct Event {
    enum class Kind : std::uint8_t { kText, kBinary, kPing, kPong, kClose, kFailed, kFrame };
    Kind kind = Kind::kFailed;
    ByteView payload{};                 ///< kClose: the reason. Valid until the next call.
    CloseCode code = CloseCode::kNone;  ///< kClose: the peer's. kFailed: what to close with.
    std::string_view why{};             ///< kFailed: for messages.
    // kFrame: a frame begins; nothing of its payload was taken.
    Opcode opcode = Opcode::kContinuation;  ///< Its message's, if it continues one.
    bool last = false;                      ///< Of its message.
    std::uint64_t bytes = 0;                ///< Of its payload.
    std::uint64_t before = 0;               ///< Of its message, in earlier frames.
  };

  explicit MessageReader(const Limits& limits) : limits_(limits) {}

  /// Takes bytes off the front of `input`, which came at `now_us`, unmasking them in place, up to the end of one event.
  /// Nothing: needs more bytes. Discards everything after kClose and kFailed.
  std::optional<Event> next(std::span<std::uint8_t>& input, TimeUs now_us);
  /// How far an incomplete message is behind the pace of half a link of 64 kbit/s. Early bytes, empty fragments and
  /// control frames in between count for nothing. 0: none is incomplete.
  static constexpr TimeUs kUsPerByte = 250;
  TimeUs behind_us(TimeUs now_us) const {
    return message_ == Opcode::kContinuation ? 0 : std::max<TimeUs>(0, now_us - pace_us_);
  }
  /// Reading pauses for so long, which is not the peer's fault: counts once for each message.
  void excuse(TimeUs pause_us) {
    if (!std::exchange(excused_, true)) pace_us_ += pause_us;
  }
  /// Memory that an incomplete message takes; grows by no more than input does, or twofold.
  std::size_t held_bytes() const { return kept_.capacity() + control_.capacity(); }
  /// Frees that memory and discards all further input.
  void stop();

 private:
  using Failure = std::optional<Event>;
  bool take_head(std::span<std::uint8_t>& input);
  Failure check_head_start();
  Failure open_frame();
  std::optional<Event> take_payload(std::span<std::uint8_t>& input);
  std::optional<Event> end_data(ByteView last);
  std::optional<Event> end_control(ByteView payload);
  Event close_event(ByteView payload);
  Event failed(CloseCode code, std::string_view why);
  bool is_control() const { return (head_[0] & 0x08) != 0; }
  std::size_t max_message_bytes() const { return message_ == Opcode::kText ? limits_.max_text : limits_.max_binary; }

  Limits limits_;
  Bytes kept_;     ///< The received part of an incomplete message.
  Bytes control_;  ///< The same for a control frame, which may come in between.
  std::uint64_t remaining_ = 0;
  TimeUs now_us_ = 0;
  TimeUs pace_us_ = 0;  ///< When the bytes of the incomplete message would have come at that pace; at most now.
  std::array<std::uint8_t, 14> head_{};
  std::array<std::uint8_t, 4> mask_{};
  std::uint8_t head_size_ = 0;
  std::uint8_t mask_at_ = 0;
  Opcode message_ = Opcode::kContinuation;  ///< The incomplete message's; kContinuation: none.
  Utf8Check utf8_;
  bool in_payload_ = false;
  bool handed_on_ = false;  ///< The last event may lie in kept_ or control_.
  bool excused_ = false;
  bool ended_ = false;
};

}  // namespace eigencast::broker::websocket
