// SPDX-License-Identifier: MIT
// The writing half of a connection: from the outbox to the socket.
#include <algorithm>
#include <array>
#include <utility>

#include "broker/connections/connection.h"
#include "broker/sockets/peer_window.h"

namespace eigencast::broker {
namespace {

using websocket::Opcode;

// Bounds one write, so that frames behind it can still be replaced by newer ones.
constexpr std::size_t kMaxWriteBytes = 128 * 1024;
// More streams that have something wait, all of those of a viewer that comes back, until the slice of the write.
constexpr std::size_t kAtOnce = 2;
constexpr int kMaxRecords = 4;  // Of TLS, in one slice.
// About what a write takes on the machine of docs/performance.md, besides each message of it, and a record of TLS.
constexpr double kWriteUs = 3, kPieceUs = 1, kWrittenBytesPerUs = 6'000, kRecordUs = 3;
constexpr double kQueuedUs = 0.2;                   // A frame for a connection, whether it leaves or not.
constexpr double kCheckUs = 2.5;                    // Of the peer's window.
constexpr std::size_t kOnItsWayBytes = 128 * 1024;  // To one who reads.

ByteView bytes_of(const Outbox::Item& item) {
  if (item.frame) return item.frame->wire;
  return {reinterpret_cast<const std::uint8_t*>(item.text->data()), item.text->size()};
}

}  // namespace

void Connection::send_droppable(const Outbox::Text& text) {
  if (!closing_ && outbox_.push_droppable(text)) schedule_write();
}

void Connection::deliver(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  Turn& turn = context_.turn;
  const Frame& frame = *frames.begin()->get();
  const bool now = frames.size() == 1 && !blocked_ && !closing_ && write_queue_.empty() && !transport_.is_tls() &&
                   turn.writes_at_once() && !turn.is_sending(*this);
  if (!now || !outbox_.send_directly(stream_id, frame, turn.now_us())) return deliver_queued(stream_id, frames);
  turn.note_written_at_once(frame.wire.size());
  note_write(frame);
  count_sent(1, std::ssize(frame.wire));
  if (watch_.note_sent()) window_check_due_ = true;
  alone_ = &frame;
  if (turn.batches())
    return turn.send(*this, transport_.socket().native_handle(), frame.wire, *frames.begin(), window_check_due_);
  const std::int64_t put = transport_.send(frame.wire);
  if (put != std::ssize(frame.wire) || window_check_due_) sent(Transport::outcome_of(put, Transport::Wait::kWritable));
}

void Connection::sent(const Transport::Outcome& outcome) {
  guarded([&] {
    const std::size_t size = alone_->wire.size();
    if (outcome.bytes == size) return window_check_due_ ? check_window() : void();
    count_sent(-1, -static_cast<std::int64_t>(size));  // Not yet: deliver() counted it.
    write_queue_.insert(write_queue_.begin(), {nullptr, alone_->shared_from_this()});
    queued_bytes_ += size;
    written(outcome);
  });
}

void Connection::deliver_queued(std::uint32_t stream_id, std::span<const FramePtr> frames) {
  if (watch_.is_check_due(context_.turn.now_us())) {
    window_check_due_ = true;
    context_.turn.add(*this, false);
  }
  // It cannot pay: a join follows.
  if (outbox_.is_held(context_.turn.now_us())) return outbox_.miss(stream_id, frames.size());
  offered_ += frames.size();
  for (const FramePtr& frame : frames) {
    outbox_.offer(stream_id, frame);
    schedule_write();
  }
}

void Connection::schedule_write() {
  // What is late takes the newest along once it has left.
  if (blocked_ || close_queued_ || Turn::is_late(*this)) return;
  guarded([this] {
    const bool urgent = closing_ || outbox_.control_messages() > 0;
    // Joins are coded in the slice of the write: those of many connections would be in one.
    const bool at_once = outbox_.waiting(context_.turn.now_us()) <= kAtOnce && !outbox_.needs_join();
    const std::uint64_t poses = closing_ || at_once ? fill_write_queue() : 1;
    if (pieces_due() == 0) return;
    const bool full = queued_bytes_ >= kMaxWriteBytes || pieces_due() >= kMaxPieces;
    const bool may_wait = outbox_.lanes() > 1 && context_.turn.gathers(poses) && !urgent && !full;
    context_.turn.add(*this, may_wait);
  });
}

std::size_t Connection::pieces_due() const {
  const std::size_t waiting = outbox_.control_messages() + outbox_.waiting(context_.turn.now_us());
  return std::min(write_queue_.size() + waiting, std::size_t{kMaxPieces});
}

std::uint64_t Connection::fill_write_queue() {
  std::uint64_t poses = 0;
  const auto join = [this](std::uint32_t id) { return join_of(id); };
  // Joins that are coded for it alone may take long: the rest comes in slices of its own.
  const double coded_us = output_us_;
  while (queued_bytes_ < kMaxWriteBytes && write_queue_.size() < kMaxPieces && !close_queued_ &&
         output_us_ - coded_us < Turn::kSliceUs) {
    auto item = closing_ ? outbox_.take_control() : outbox_.take(context_.turn.now_us(), join);
    if (!item && !closing_) break;
    if (!item) {
      const auto close = websocket::framed_close(close_code_, close_reason_);
      item = Outbox::Item{close, nullptr};
      close_queued_ = true;
    }
    poses += item->frame ? 1 : 0;
    queued_bytes_ += bytes_of(*item).size();
    write_queue_.push_back(std::move(*item));
  }
  return poses;
}

std::size_t Connection::unread_answers() {
  if (!blocked_ || closing_) return 0;
  const std::size_t in_kernel = transport_.unacknowledged();
  std::size_t bytes = outbox_.control_memory() + in_kernel - std::min(in_kernel, kOnItsWayBytes);
  for (const Outbox::Item& item : write_queue_) bytes += bytes_of(item).size() + (item.text ? Outbox::kTextBytes : 0);
  return bytes;
}

double Connection::write_us() const {
  const double check_us = window_check_due_ ? kCheckUs : 0;
  if (blocked_ || pieces_due() == 0) return check_us;
  return check_us + kWriteUs + kPieceUs * static_cast<double>(pieces_due()) +
         static_cast<double>(queued_bytes_) / kWrittenBytesPerUs + (transport_.is_tls() ? kRecordUs : 0);
}

void Connection::pay_for_output() {
  // Fewer than before where bytes counted as sent did not leave.
  const auto since = [](std::uint64_t& paid, std::uint64_t sent) {
    return static_cast<double>(static_cast<std::int64_t>(sent - std::exchange(paid, sent)));
  };
  const double frames = since(frames_paid_, frames_sent_), bytes = since(bytes_paid_, bytes_sent_);
  const double writes = frames - static_cast<double>(std::exchange(joined_, 0));
  const double work_us = std::exchange(output_us_, 0) + kWriteUs * writes + kPieceUs * frames +
                         bytes / kWrittenBytesPerUs + kQueuedUs * static_cast<double>(std::exchange(offered_, 0)) +
                         kRecordUs * static_cast<double>(std::exchange(records_, 0));
  const TimeUs now_us = context_.turn.now_us();
  const TimeUs paid_us = grant_->charge_deliveries(work_us, now_us);
  outbox_.hold_until(paid_us > 0 ? now_us + std::min(paid_us, kMaxPauseUs) : 0);
}

int Connection::plain_socket() {
  return transport_.is_tls() || window_check_due_ ? -1 : transport_.socket().native_handle();
}

std::size_t Connection::pieces(std::span<iovec> out) {
  if (!blocked_) guarded([this] { fill_write_queue(); });
  if (blocked_) return 0;
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
  if (window_check_due_) {
    guarded([this] {
      check_window();
      schedule_write();
    });
  }
  context_.turn.forget(*this);
  std::array<iovec, kMaxPieces> all;
  // TLS takes one record at a time; the rest is offered again until it has to wait.
  for (int records = 0; records < kMaxRecords; ++records) {
    const std::size_t count = pieces(all);
    if (count == 0) return;
    if (transport_.is_tls()) ++records_;
    written(transport_.write({all.data(), count}));
    if (!transport_.is_tls() || blocked_) return;
  }
  if (!ended_) context_.turn.add(*this, false);
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
  if (frame.times.written_us == 0) note_first_write(frame.times);
}

void Connection::note_first_write(FrameTimes& times) {
  times.written_us = steady_now_us();
  const TimeUs from_us = times.due_us != 0 ? times.due_us : times.arrival_us;
  if (from_us != 0) context_.counters.latency.add(times.written_us - from_us);
  if (times.due_us != 0 && times.arrival_us != 0) context_.counters.hold.add(times.due_us - times.arrival_us);
}

void Connection::check_window() {
  window_check_due_ = false;
  pay_for_output();
  if (closing_ || ended_ || outbox_.acknowledges()) return;
  const auto window = peer_window(transport_.socket().native_handle());
  if (!window) return;
  const bool ask = watch_.note_window(window->bytes, window->round_trip_us, context_.turn.now_us());
  outbox_.hold_from(watch_.hold_from_us());
  if (ask) send_framed(websocket::framed(Opcode::kPing, watch_.probe()));
}

void Connection::drop_written(std::size_t bytes) {
  std::size_t whole = 0, frames = 0;
  partial_bytes_ += bytes;
  for (; whole < write_queue_.size(); ++whole) {
    const std::size_t size = bytes_of(write_queue_[whole]).size();
    if (partial_bytes_ < size) break;
    partial_bytes_ -= size;
    queued_bytes_ -= size;
    if (!write_queue_[whole].frame) continue;
    count_sent(1, static_cast<std::int64_t>(size));
    joined_ += frames++ > 0 ? 1 : 0;
    if (watch_.note_sent()) window_check_due_ = true;
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
    outbox_.drop_unsent(item.frame);
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
