// SPDX-License-Identifier: MIT
#include "broker/websocket/reader.h"

#include <cstring>

namespace eigencast::broker::websocket {
namespace {

using Kind = MessageReader::Event::Kind;

constexpr std::uint8_t kFin = 0x80;
constexpr std::uint8_t kReserved = 0x70;
constexpr std::uint8_t kMasked = 0x80;
constexpr std::size_t kMaskBytes = 4;

/// Bytes of the length beyond the seven bits in the second byte.
std::size_t length_bytes(std::uint8_t second) {
  const unsigned bits = second & 0x7f;
  return bits == 127 ? 8 : bits == 126 ? 2 : 0;
}

void unmask(std::span<std::uint8_t> bytes, std::array<std::uint8_t, 4> mask, std::uint8_t& at) {
  std::rotate(mask.begin(), mask.begin() + at, mask.end());
  std::uint64_t wide = 0;
  for (std::size_t i = 0; i < sizeof wide; i += mask.size())
    std::memcpy(reinterpret_cast<std::uint8_t*>(&wide) + i, mask.data(), mask.size());
  std::size_t i = 0;
  for (std::uint64_t word = 0; i + sizeof word <= bytes.size(); i += sizeof word) {
    std::memcpy(&word, bytes.data() + i, sizeof word);
    word ^= wide;
    std::memcpy(bytes.data() + i, &word, sizeof word);
  }
  for (; i < bytes.size(); ++i) bytes[i] ^= mask[i % mask.size()];
  at = static_cast<std::uint8_t>((at + bytes.size()) % mask.size());
}

std::size_t ascii_run(ByteView bytes) {
  std::size_t at = 0;
  for (std::uint64_t word = 0; at + sizeof word <= bytes.size(); at += sizeof word) {
    std::memcpy(&word, bytes.data() + at, sizeof word);
    if ((word & 0x8080808080808080u) != 0) break;
  }
  return at;
}

}  // namespace

bool Utf8Check::add(ByteView bytes) {
  std::size_t at = 0;
  while (at < bytes.size()) {
    if (remaining_ == 0) {
      at += ascii_run(bytes.subspan(at));
      if (at == bytes.size()) return true;
      if (!lead(bytes[at++])) return false;
      continue;
    }
    const std::uint8_t byte = bytes[at++];
    if (byte < min_ || byte > max_) return false;
    min_ = 0x80;
    max_ = 0xbf;
    --remaining_;
  }
  return true;
}

bool Utf8Check::lead(std::uint8_t byte) {
  if (byte < 0x80) return true;
  if (byte < 0xc2 || byte > 0xf4) return false;
  remaining_ = byte < 0xe0 ? 1 : byte < 0xf0 ? 2 : 3;
  if (byte == 0xe0) min_ = 0xa0;
  if (byte == 0xed) max_ = 0x9f;
  if (byte == 0xf0) min_ = 0x90;
  if (byte == 0xf4) max_ = 0x8f;
  return true;
}

std::optional<MessageReader::Event> MessageReader::next(std::span<std::uint8_t>& input, TimeUs now_us) {
  now_us_ = now_us;
  if (handed_on_) {
    handed_on_ = false;
    if (message_ == Opcode::kContinuation) Bytes().swap(kept_);
    Bytes().swap(control_);
  }
  for (;;) {
    if (ended_) {
      input = {};
      return std::nullopt;
    }
    if (!in_payload_) {
      if (input.empty()) return std::nullopt;
      const bool whole = take_head(input);
      if (auto failure = check_head_start()) return failure;
      if (!whole) return std::nullopt;
      if (auto failure = open_frame()) return failure;
      const Opcode opcode = is_control() ? static_cast<Opcode>(head_[0] & 0x0f) : message_;
      const std::uint64_t before = is_control() ? 0 : kept_.size();
      return Event{Kind::kFrame, {}, CloseCode::kNone, {}, opcode, (head_[0] & kFin) != 0, remaining_, before};
    }
    if (input.empty() && remaining_ > 0) return std::nullopt;
    if (auto event = take_payload(input)) return event;
  }
}

bool MessageReader::take_head(std::span<std::uint8_t>& input) {
  while (!input.empty()) {
    head_[head_size_++] = input.front();
    input = input.subspan(1);
    if (head_size_ >= 2 && head_size_ == 2 + length_bytes(head_[1]) + kMaskBytes) return true;
  }
  return false;
}

MessageReader::Failure MessageReader::check_head_start() {
  const auto wrong = [this](std::string_view why) { return failed(CloseCode::kProtocolError, why); };
  const auto opcode = static_cast<std::uint8_t>(head_[0] & 0x0f);
  if ((head_[0] & kReserved) != 0) return wrong("a reserved bit is set, and no extension was agreed on");
  if ((opcode > 2 && opcode < 8) || opcode > 10) return wrong("an opcode that does not exist");
  if (is_control() && (head_[0] & kFin) == 0) return wrong("a control frame in fragments");
  if (opcode == 0 && message_ == Opcode::kContinuation) return wrong("a continuation of nothing");
  if ((opcode == 1 || opcode == 2) && message_ != Opcode::kContinuation)
    return wrong("a message within a message that has not ended");
  if (head_size_ < 2) return std::nullopt;
  if ((head_[1] & kMasked) == 0) return wrong("a client's frame without a mask");
  if (is_control() && (head_[1] & 0x7f) > kMaxControlBytes) return wrong("a control frame over 125 bytes");
  return std::nullopt;
}

MessageReader::Failure MessageReader::open_frame() {
  const std::size_t extra = length_bytes(head_[1]);
  remaining_ = head_[1] & 0x7f;
  if (extra > 0) {
    remaining_ = 0;
    for (std::size_t i = 0; i < extra; ++i) remaining_ = remaining_ << 8 | head_[2 + i];
    if (remaining_ >> 63 != 0) return failed(CloseCode::kProtocolError, "a length over 63 bits");
    if (remaining_ <= (extra == 2 ? kMaxControlBytes : 0xffff))
      return failed(CloseCode::kProtocolError, "a length not in its shortest form");
  }
  std::copy_n(head_.begin() + 2 + extra, kMaskBytes, mask_.begin());
  mask_at_ = 0;
  in_payload_ = true;
  if (is_control()) return std::nullopt;
  if ((head_[0] & 0x0f) != 0) {
    message_ = static_cast<Opcode>(head_[0] & 0x0f);
    utf8_ = {};
    pace_us_ = now_us_;
    excused_ = false;
  }
  if (remaining_ > max_message_bytes() || kept_.size() > max_message_bytes() - remaining_)
    return failed(CloseCode::kTooBig, "a message over the limit");
  return std::nullopt;
}

std::optional<MessageReader::Event> MessageReader::take_payload(std::span<std::uint8_t>& input) {
  const auto count = static_cast<std::size_t>(std::min<std::uint64_t>(remaining_, input.size()));
  const auto piece = input.first(count);
  input = input.subspan(count);
  unmask(piece, mask_, mask_at_);
  remaining_ -= count;
  if (is_control()) {
    if (remaining_ > 0 || !control_.empty()) control_.insert(control_.end(), piece.begin(), piece.end());
    return remaining_ > 0 ? std::nullopt : end_control(control_.empty() ? ByteView(piece) : ByteView(control_));
  }
  pace_us_ = std::min(now_us_, pace_us_ + static_cast<TimeUs>(count) * kUsPerByte);
  if (message_ == Opcode::kText && !utf8_.add(piece)) return failed(CloseCode::kBadPayload, "a text that is not UTF-8");
  if (remaining_ > 0) {
    kept_.insert(kept_.end(), piece.begin(), piece.end());
    return std::nullopt;
  }
  return end_data(piece);
}

std::optional<MessageReader::Event> MessageReader::end_data(ByteView last) {
  const bool fin = (head_[0] & kFin) != 0;
  in_payload_ = false;
  head_size_ = 0;
  if (!fin || !kept_.empty()) kept_.insert(kept_.end(), last.begin(), last.end());
  if (!fin) return std::nullopt;
  const bool text = message_ == Opcode::kText;
  if (text && !utf8_.is_whole()) return failed(CloseCode::kBadPayload, "a text that ends within a character");
  message_ = Opcode::kContinuation;
  handed_on_ = true;
  return Event{text ? Kind::kText : Kind::kBinary, kept_.empty() ? last : ByteView(kept_)};
}

std::optional<MessageReader::Event> MessageReader::end_control(ByteView payload) {
  in_payload_ = false;
  head_size_ = 0;
  handed_on_ = true;
  const auto opcode = static_cast<Opcode>(head_[0] & 0x0f);
  if (opcode == Opcode::kClose) return close_event(payload);
  return Event{opcode == Opcode::kPing ? Kind::kPing : Kind::kPong, payload};
}

MessageReader::Event MessageReader::close_event(ByteView payload) {
  if (payload.size() == 1) return failed(CloseCode::kProtocolError, "half a close code");
  Event event{Kind::kClose};
  if (!payload.empty()) {
    const auto code = static_cast<std::uint16_t>(payload[0] << 8 | payload[1]);
    if (!is_valid_close_code(code)) return failed(CloseCode::kProtocolError, "a close code that must not be sent");
    event.code = static_cast<CloseCode>(code);
    event.payload = payload.subspan(2);
    Utf8Check reason;
    if (!reason.add(event.payload) || !reason.is_whole())
      return failed(CloseCode::kBadPayload, "a close reason that is not UTF-8");
  }
  ended_ = true;
  return event;
}

void MessageReader::stop() {
  ended_ = true;
  message_ = Opcode::kContinuation;
  Bytes().swap(kept_);
}

MessageReader::Event MessageReader::failed(CloseCode code, std::string_view why) {
  stop();
  return {Kind::kFailed, {}, code, why};
}

}  // namespace eigencast::broker::websocket
