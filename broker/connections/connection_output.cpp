// SPDX-License-Identifier: MIT
// The writing half of a connection: from the outbox to the socket.
#include <array>
#include <utility>

#include "broker/connections/connection.h"
#include "broker/sockets/peer_window.h"

namespace eigencast::broker {
namespace {

using websocket::Opcode;

// Bounds one write, so that frames behind it can still be replaced by newer ones.
constexpr std::size_t kMaxWriteBytes = 128 * 1024;

ByteView bytes_of(const Outbox::Item& item) {
  if (item.frame) return item.frame->wire;
  return {reinterpret_cast<const std::uint8_t*>(item.text->data()), item.text->size()};
}

}  // namespace

void Connection::send_droppable(const Outbox::Text& text) {
  if (!closing_ && outbox_.push_droppable(text)) schedule_write();
}

bool Connection::can_write_now() const {
  if (blocked_ || !open_ || ended_ || closing_ || !write_queue_.empty() || outbox_.lanes() != 1) return false;
  return context_.turn.writes_singly() && !transport_.is_tls();
}

void Connection::deliver(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  if (frames.size() != 1 || !can_write_now()) return deliver_queued(stream_id, frames);
  const Frame& frame = *frames[0];
  if (!outbox_.send_directly(stream_id, frame, context_.turn.now_us())) return deliver_queued(stream_id, frames);
  note_write(frame);
  const iovec piece{const_cast<std::uint8_t*>(frame.wire.data()), frame.wire.size()};
  const Transport::Outcome outcome = transport_.write({&piece, 1});
  if (outcome.bytes != piece.iov_len) return write_partly(frames[0], outcome);
  count_sent(outcome.bytes);
  if (window_check_due_) check_window();
}

void Connection::deliver_queued(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  for (const FramePtr& frame : frames) {
    outbox_.offer(stream_id, frame);
    schedule_write();
  }
}

void Connection::write_partly(const FramePtr& frame, const Transport::Outcome& outcome) {
  guarded([&] {
    write_queue_.push_back({nullptr, frame});
    queued_bytes_ += frame->wire.size();
    written(outcome);
  });
}

void Connection::schedule_write() {
  if (blocked_ || !open_ || ended_ || close_queued_) return;
  guarded([this] { fill_write_queue(); });
}

void Connection::fill_write_queue() {
  std::uint64_t poses = 0;
  bool urgent = closing_;
  const auto join = [this](std::uint32_t id) { return join_of(id); };
  while (queued_bytes_ < kMaxWriteBytes && write_queue_.size() < kMaxPieces && !close_queued_) {
    auto item = outbox_.take(context_.turn.now_us(), join);
    if (!item && !closing_) break;
    if (!item) {
      const auto close = std::make_shared<const std::string>(websocket::framed_close(close_code_, close_reason_));
      item = Outbox::Item{close, nullptr};
      close_queued_ = true;
    } else if (closing_ && item->frame) {
      continue;
    }
    urgent = urgent || item->text != nullptr;
    poses += item->frame ? 1 : 0;
    queued_bytes_ += bytes_of(*item).size();
    write_queue_.push_back(std::move(*item));
  }
  if (write_queue_.empty()) return;
  const bool full = queued_bytes_ >= kMaxWriteBytes || write_queue_.size() >= kMaxPieces;
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
  std::size_t skip = partial_bytes_;
  for (const Outbox::Item& item : write_queue_) {
    if (count == out.size()) break;
    if (item.frame) note_write(*item.frame);
    const ByteView bytes = bytes_of(item).subspan(std::exchange(skip, 0));
    out[count++] = {const_cast<std::uint8_t*>(bytes.data()), bytes.size()};
  }
  return count;
}

void Connection::flush() {
  std::array<iovec, kMaxPieces> all;
  // TLS takes one record at a time; the rest is offered again until it has to wait.
  do {
    const std::size_t count = pieces(all);
    if (count == 0) return;
    written(transport_.write({all.data(), count}));
  } while (transport_.is_tls() && !blocked_);
}

void Connection::written(const Transport::Outcome& outcome) {
  guarded([&] {
    if (ended_) return;
    if (outcome.error) {  // Later: the caller may be iterating over all watchers.
      blocked_ = true;
      return close_later();
    }
    drop_written(outcome.bytes);
    if (window_check_due_) check_window();
    if (write_queue_.empty()) {
      on_all_written();
      return resume_reading();
    }
    if (transport_.is_tls() && outcome.wait == Transport::Wait::kNo) return;
    block(outcome.wait == Transport::Wait::kNo ? Transport::Wait::kWritable : outcome.wait);
  });
}

void Connection::note_write(const Frame& frame) {
  FrameTimes& times = frame.times;
  if (times.written_us != 0) return;
  times.written_us = steady_now_us();
  const TimeUs from_us = times.due_us != 0 ? times.due_us : times.arrival_us;
  if (from_us != 0) context_.counters.latency.add(times.written_us - from_us);
  if (times.due_us != 0 && times.arrival_us != 0) context_.counters.hold.add(times.due_us - times.arrival_us);
}

void Connection::count_sent(std::size_t bytes) {
  ++context_.counters.frames_sent;
  context_.counters.frame_bytes_sent += bytes;
  ++frames_sent_;
  bytes_sent_ += bytes;
  if (watch_.note_sent()) window_check_due_ = true;
}

void Connection::check_window() {
  window_check_due_ = false;
  if (closing_ || ended_ || outbox_.acknowledges()) return;
  const auto window = peer_window(transport_.socket().native_handle());
  if (!window) return;
  const bool ask = watch_.note_window(window->bytes, window->round_trip_us, context_.turn.now_us());
  outbox_.hold_from(watch_.hold_from_us());
  if (ask) send_framed(websocket::framed(Opcode::kPing, watch_.probe()));
}

void Connection::drop_written(std::size_t bytes) {
  std::size_t whole = 0;
  partial_bytes_ += bytes;
  for (; whole < write_queue_.size(); ++whole) {
    const std::size_t size = bytes_of(write_queue_[whole]).size();
    if (partial_bytes_ < size) break;
    partial_bytes_ -= size;
    queued_bytes_ -= size;
    if (!write_queue_[whole].frame) continue;
    count_sent(size);
  }
  write_queue_.erase(write_queue_.begin(), write_queue_.begin() + static_cast<std::ptrdiff_t>(whole));
}

void Connection::on_all_written() {
  if (!std::exchange(greeted_, true)) {  // The queue rarely grows this large again.
    write_queue_.shrink_to_fit();
    outbox_.shrink();
  }
  if (close_queued_) return end_writing_when_closed();
  schedule_write();  // Messages beyond kMaxWriteBytes.
}

void Connection::block(Transport::Wait wait) {
  blocked_ = true;
  // The peer may pause for long: frames not begun must give way to newer ones.
  std::size_t begun = partial_bytes_ + transport_.held_bytes();
  std::erase_if(write_queue_, [&](const Outbox::Item& item) {
    const std::size_t size = bytes_of(item).size();
    if (begun > 0) {
      begun -= std::min(begun, size);
      return false;
    }
    if (!item.frame) return false;
    outbox_.drop_unsent(*item.frame);
    queued_bytes_ -= size;
    return true;
  });
  transport_.async_wait(wait, [self = shared_from_this()](ErrorOf error) {
    if (error || self->ended_) return;
    self->blocked_ = false;
    if (!self->write_queue_.empty()) self->context_.turn.add(*self, false);
    self->schedule_write();
    self->resume_reading();
  });
}

}  // namespace eigencast::broker
