// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "broker/websocket/protocol.h"
#include "broker/websocket/utf8.h"
#include "common/core/bytes.h"

namespace eigencast::broker::websocket {

/// Takes the byte stream of a client apart into messages, strictly by RFC 6455.
///
/// Bytes come in pieces of any size; what cannot be the beginning of a valid stream is refused at the first byte that
/// shows it. A message that lies whole in one piece is handed on where it lies; only an incomplete one is copied, never
/// more than has come, so that an idle reader holds no memory. Safe on hostile input. Not thread-safe.
class MessageReader {
 public:
  struct Limits {
    std::size_t max_text = 65'536;       ///< Bytes of a whole text message.
    std::size_t max_binary = 1'048'576;  ///< Bytes of a whole binary message.
  };
  struct Event {
    enum class Kind : std::uint8_t { kText, kBinary, kPing, kPong, kClose, kFailed };
    Kind kind = Kind::kFailed;
    ByteView payload;                   ///< Of kClose: the reason. Valid until the next call.
    CloseCode code = CloseCode::kNone;  ///< kClose: the peer's. kFailed: what to close with.
    std::string_view why;               ///< kFailed: for people.
  };

  explicit MessageReader(const Limits& limits) : limits_(limits) {}

  /// Takes bytes off the front of `input`, unmasking them in place, up to the end of one event. Nothing: all was taken
  /// and more is needed. After kClose and kFailed everything is swallowed.
  std::optional<Event> next(std::span<std::uint8_t>& input);

 private:
  using Failure = std::optional<Event>;
  /// Takes what is there of a frame's head. True: it is whole.
  bool take_head(std::span<std::uint8_t>& input);
  /// Looks at the bytes of the head that are there, so that a bad one is refused at once.
  Failure check_head_start();
  Failure open_frame();
  std::optional<Event> take_payload(std::span<std::uint8_t>& input);
  std::optional<Event> end_data(ByteView last);
  std::optional<Event> end_control(ByteView payload);
  Event close_event(ByteView payload);
  Event failed(CloseCode code, std::string_view why);
  bool is_control() const { return (head_[0] & 0x08) != 0; }
  std::size_t most() const { return message_ == Opcode::kText ? limits_.max_text : limits_.max_binary; }

  Limits limits_;
  Bytes kept_;     ///< What came of a message that is not whole yet.
  Bytes control_;  ///< The same of a control frame, which may come in between.
  std::uint64_t left_ = 0;
  std::array<std::uint8_t, 14> head_{};
  std::array<std::uint8_t, 4> mask_{};
  std::uint8_t head_size_ = 0;
  std::uint8_t mask_at_ = 0;
  Opcode message_ = Opcode::kContinuation;  ///< Of the message that is coming; kContinuation: none is.
  Utf8Check utf8_;
  bool in_payload_ = false;
  bool handed_on_ = false;  ///< The last event may lie in kept_ or control_.
  bool ended_ = false;
};

}  // namespace eigencast::broker::websocket
