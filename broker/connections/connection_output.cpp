// SPDX-License-Identifier: MIT
//
// The half of a connection that writes: what the outbox lets go, and what the socket makes of it.
#include <array>
#include <utility>

#include "broker/connections/connection.h"
#include "broker/connections/peer_window.h"

namespace eigencast::broker {
namespace {

using websocket::Opcode;

// One write takes at most so much, so that what waits behind it can still be replaced by something newer.
constexpr std::size_t kMostDueBytes = 128 * 1024;

ByteView bytes_of(const Outbox::Item& item) {
  if (item.frame) return item.frame->wire;
  return {reinterpret_cast<const std::uint8_t*>(item.text->data()), item.text->size()};
}

}  // namespace

void Connection::send_droppable(const Outbox::Text& text) {
  if (!closing_ && outbox_.push_droppable(text)) flush();
}

bool Connection::leaves_at_once() const {
  if (blocked_ || !open_ || ended_ || closing_ || !due_.empty() || outbox_.lanes() != 1) return false;
  return context_.turn.writes_singly() && !transport_.is_tls();
}

void Connection::deliver(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  if (frames.size() != 1 || !leaves_at_once()) return deliver_in_turn(stream_id, frames);
  const Frame& frame = *frames[0];
  if (!outbox_.pass(stream_id, frame, context_.turn.now_us())) return deliver_in_turn(stream_id, frames);
  note_leaving(frame);
  const iovec piece{const_cast<std::uint8_t*>(frame.wire.data()), frame.wire.size()};
  const Transport::Outcome outcome = transport_.write({&piece, 1});
  if (outcome.bytes != piece.iov_len) return left_in_part(frames[0], outcome);
  count_sent(outcome.bytes);
  if (look_due_) look();
}

void Connection::deliver_in_turn(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  for (const FramePtr& frame : frames) {
    outbox_.offer(stream_id, frame);
    flush();
  }
}

void Connection::left_in_part(const FramePtr& frame, const Transport::Outcome& outcome) {
  guarded([&] {
    due_.push_back({nullptr, frame});
    due_bytes_ += frame->wire.size();
    left(outcome);
  });
}

void Connection::flush() {
  if (blocked_ || !open_ || ended_ || close_due_) return;
  try {
    gather();
  } catch (const std::exception& exception) {
    log_failure(exception);
    cut_later();
  }
}

void Connection::gather() {
  std::uint64_t poses = 0;
  bool urgent = closing_;
  const auto join = [this](std::uint32_t id) { return join_of(id); };
  while (due_bytes_ < kMostDueBytes && due_.size() < kMaxPieces) {
    auto item = outbox_.take(context_.turn.now_us(), join);
    if (!item) {
      if (closing_) {
        item = Outbox::Item{std::make_shared<const std::string>(websocket::framed_close(close_code_, close_reason_)),
                            nullptr};
        close_due_ = true;
      } else {
        break;
      }
    } else if (closing_ && item->frame) {
      continue;
    }
    urgent = urgent || item->text != nullptr;
    poses += item->frame ? 1 : 0;
    due_bytes_ += bytes_of(*item).size();
    due_.push_back(std::move(*item));
    if (close_due_) break;
  }
  if (due_.empty()) return;
  const bool full = due_bytes_ >= kMostDueBytes || due_.size() >= kMaxPieces;
  const bool several = outbox_.lanes() > 1;
  const bool may_wait = several && context_.turn.gathers(poses) && !urgent && !full;
  context_.turn.add(*this, may_wait);
}

int Connection::plain_socket() {
  return transport_.is_tls() ? -1 : transport_.socket().native_handle();
}

std::size_t Connection::pieces(std::span<iovec> out) {
  if (blocked_ || ended_) return 0;
  std::size_t count = 0;
  std::size_t skip = first_left_;
  for (const Outbox::Item& item : due_) {
    if (count == out.size()) break;
    if (item.frame) note_leaving(*item.frame);
    const ByteView bytes = bytes_of(item).subspan(std::exchange(skip, 0));
    out[count++] = {const_cast<std::uint8_t*>(bytes.data()), bytes.size()};
  }
  return count;
}

void Connection::leave() {
  std::array<iovec, kMaxPieces> all;
  // TLS takes a record at a time; what it did not take yet is offered again until it has to wait.
  do {
    const std::size_t count = pieces(all);
    if (count == 0) return;
    left(transport_.write({all.data(), count}));
  } while (transport_.is_tls() && !blocked_);
}

void Connection::left(const Transport::Outcome& outcome) {
  guarded([&] {
    if (ended_) return;
    if (outcome.error) {  // Later: whoever makes this connection write may be in the middle of all its watchers.
      blocked_ = true;
      return cut_later();
    }
    drop_sent(outcome.bytes);
    if (look_due_) look();
    if (due_.empty()) {
      all_left();
      return read_on();
    }
    if (transport_.is_tls() && outcome.wait == Transport::Wait::kNo) return;
    block(outcome.wait == Transport::Wait::kNo ? Transport::Wait::kWritable : outcome.wait);
  });
}

void Connection::note_leaving(const Frame& frame) {
  FrameTimes& times = frame.times;
  if (times.left_us != 0) return;
  times.left_us = steady_now_us();
  const TimeUs from_us = times.due_us != 0 ? times.due_us : times.arrival_us;
  if (from_us != 0) context_.counters.latency.add(times.left_us - from_us);
  if (times.due_us != 0 && times.arrival_us != 0) context_.counters.hold.add(times.due_us - times.arrival_us);
}

void Connection::count_sent(std::size_t bytes) {
  ++context_.counters.frames_sent;
  context_.counters.frame_bytes_sent += bytes;
  ++frames_sent_;
  bytes_sent_ += bytes;
  if (watch_.note_sent()) look_due_ = true;
}

void Connection::look() {
  look_due_ = false;
  if (closing_ || ended_ || outbox_.acknowledges()) return;
  const auto window = peer_window(transport_.socket().native_handle());
  if (!window) return;
  const bool ask = watch_.note_window(window->bytes, window->round_trip_us, context_.turn.now_us());
  outbox_.hold_from(watch_.hold_from_us());
  if (ask) send_framed(websocket::framed(Opcode::kPing, watch_.question()));
}

void Connection::drop_sent(std::size_t bytes) {
  std::size_t whole = 0;
  first_left_ += bytes;
  for (; whole < due_.size(); ++whole) {
    const std::size_t size = bytes_of(due_[whole]).size();
    if (first_left_ < size) break;
    first_left_ -= size;
    due_bytes_ -= size;
    if (!due_[whole].frame) continue;
    count_sent(size);
  }
  due_.erase(due_.begin(), due_.begin() + static_cast<std::ptrdiff_t>(whole));
}

void Connection::all_left() {
  if (!std::exchange(greeted_, true)) {  // As much as that is not due again for long.
    due_.shrink_to_fit();
    outbox_.shrink();
  }
  if (close_due_) {
    if (close_came_) transport_.end_writing();
    return;
  }
  flush();  // What one write could not take.
}

void Connection::block(Transport::Wait wait) {
  blocked_ = true;
  // The peer may stay away for long: what has not begun to leave gives way to what is new then.
  std::size_t begun = first_left_ + transport_.held_bytes();
  std::erase_if(due_, [&](const Outbox::Item& item) {
    const std::size_t size = bytes_of(item).size();
    if (begun > 0) {
      begun -= std::min(begun, size);
      return false;
    }
    if (!item.frame) return false;
    outbox_.take_back(*item.frame);
    due_bytes_ -= size;
    return true;
  });
  transport_.async_wait(wait, [self = shared_from_this()](ErrorOf error) {
    if (error || self->ended_) return;
    self->blocked_ = false;
    if (!self->due_.empty()) self->context_.turn.add(*self, false);
    self->flush();
    self->read_on();
  });
}

}  // namespace eigencast::broker
