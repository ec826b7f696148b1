// SPDX-License-Identifier: MIT
#pragma once

#include <exception>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "broker/access/gate.h"
#include "broker/context/context.h"
#include "broker/relay/outbox.h"
#include "broker/relay/reader_watch.h"
#include "broker/sockets/transport.h"
#include "broker/sockets/turn.h"
#include "broker/websocket/reader.h"
#include "common/core/bytes.h"
#include "common/core/clock.h"

namespace eigencast::broker {

/// One WebSocket: reads messages, writes what its outbox releases, closes with a reason. Publisher and Subscriber
/// interpret the messages. A peer that requests more than it reads is not read until it catches up.
///
/// Messages from the outbox wait in `write_queue_` and leave in one write at the end of the turn. When the socket takes
/// only part of it, the connection is blocked: frames not begun go back to the outbox, which keeps the newest. Holds no
/// read buffer while idle. Kept alive by its pending operations. Belongs to its event loop.
class Connection : public std::enable_shared_from_this<Connection>, private SocketWriter {
 public:
  /// Sends `answer`, the head of the response to a checked upgrade, and runs.
  void start(std::string answer);

  void send_bye(const std::string& reason, std::uint32_t retry_after_ms, websocket::CloseCode code);

  /// Whether only control messages and the close frame are still to be sent.
  bool is_closing() const { return closing_; }

  virtual void describe(ClientInfo& info) const;
  std::uint64_t id() const { return id_; }
  std::string name() const;

  /// Has it send what is new, in its turn among viewers.
  void beat();

  /// Called once a second: pings a silent peer, closes after timeouts.idle_ms or when the token expires.
  void tick();

 protected:
  /// outbox  null: by the configuration
  Connection(Context& context, Transport transport, GrantPtr grant, const websocket::MessageReader::Limits& limits,
             const Outbox::Limits* outbox = nullptr);

  virtual void on_open() = 0;
  /// Counts and parses it; passes it to on_message() unless it is a ping or pong.
  virtual void on_text(std::string_view text);
  virtual void on_message(const ControlMessage& /*message*/) {}
  virtual void on_binary(ByteView message) = 0;
  /// About how long a frame of a binary message takes.
  virtual double binary_work_us(std::uint64_t bytes, bool last) const;
  /// Called once, after the last read and write.
  virtual void on_closed() = 0;
  virtual void on_tick() {}
  /// What it sends is read later, as it is over this limit.
  virtual void on_paced(const std::string& /*limit*/) {}
  virtual void on_beat() {}
  /// Whether its messages take turns with those of all viewers.
  virtual bool takes_turns() const { return false; }
  /// The most bytes read at a time: the control queue must hold the answers to one read.
  virtual std::size_t read_bytes() const { return context_.read_buffer.size(); }
  virtual FramePtr join_of(std::uint32_t /*stream_id*/) { return nullptr; }
  virtual std::string label() const = 0;
  virtual std::string stream_name() const { return {}; }  ///< Empty: it has several.

  Context& context() { return context_; }
  const Context& context() const { return context_; }
  Grant& grant() { return *grant_; }
  const Grant& grant() const { return *grant_; }
  Outbox& outbox() { return outbox_; }
  void greet();
  /// A full queue closes the connection.
  void send(const ControlMessage& message);
  void send(const Outbox::Text& control);  ///< Framed.
  void send_framed(const Outbox::Text& message);
  void deliver(std::uint32_t stream_id, std::span<const FramePtr> frames);
  void send_droppable(const Outbox::Text& text);
  /// Has what the outbox releases written at the end of this turn, unless blocked.
  void schedule_write();
  void send_error(const Error& error, const std::string& stream);
  /// Sends the error, then closes. Ignores further messages of the peer.
  void refuse(const Error& error, const std::string& stream, websocket::CloseCode code);
  /// Closes once all control messages are written, at the latest after timeouts.shutdown_ms.
  void close_when_sent(const std::string& reason, websocket::CloseCode code);
  /// Takes work that is done from the budget of the holder: what comes next may wait for it.
  void charge(double work_us);
  /// Takes work that is done from the budget of deliveries.
  void charge_output(double work_us) {
    note_work(work_us);
    output_us_ += work_us;
  }
  /// Counts what it makes the loop do later in this turn of its own.
  void note_work(double work_us) { turn_us_ += work_us; }
  /// Runs a handler's work. An exception (no memory) closes only this connection.
  template <typename Work>
  void guarded(Work work);

 private:
  // SocketWriter. None of these throws.
  void flush() override;
  int plain_socket() override;
  std::size_t pieces(std::span<iovec> out) override;
  void written(const Transport::Outcome& outcome) override;
  void sent(const Transport::Outcome& outcome) override;
  const void* purse() const override { return grant_->purse(); }
  double write_us() const override;

  /// Something that it asks for again and again.
  struct Asked {
    double took_us;        ///< The last time, at first what it mostly takes,
    double paid_us = 0;    ///< and what is paid for this one.
    TimeUs waited_us = 0;  ///< For this one.
    bool waits = false;    ///< For its turn.
  };
  /// Runs it in its turn among all that viewers ask for, at once if nobody waits.
  void in_turn(Asked& asked, void (Connection::*work)());
  void run_paid(Asked& asked, void (Connection::*work)());

  void wait_to_read(Transport::Wait wait);
  void on_readable();
  void read();
  bool take_input(std::span<std::uint8_t> input);
  void on_event(const websocket::MessageReader::Event& event);
  void on_ping(std::string_view payload);
  void refuse_text(const Error& error);
  bool is_backlogged();
  /// Pays for the frame that begins; it may have to wait for its turn.
  void begin_frame(const websocket::MessageReader::Event& event);
  TimeUs take_control(double messages);
  /// Takes unpaid_us_ from the budget of the holder; waits at least `wait_us`.
  void pay(TimeUs wait_us);
  /// A holder over its budget waits for so long, then in turn with all who do.
  static constexpr TimeUs kMaxPauseUs = 2'000'000;
  /// Reading goes on by itself in time.
  void pause(TimeUs wait_us);
  void resume_reading();
  void end_writing_when_closed();
  void on_broken(const websocket::MessageReader::Event& event);
  /// Counts the memory of an unfinished message and of answers that are not read, and closes where it is too much.
  void count_unfinished();
  /// Frees it, and closes.
  void give_message_up(const Error& why);
  std::size_t unread_answers();
  void deliver_queued(std::uint32_t stream_id, std::span<const FramePtr> frames);
  /// Returns how many poses it took from the outbox.
  std::uint64_t fill_write_queue();
  std::size_t pieces_due() const;  ///< In the next write.
  void drop_written(std::size_t bytes);
  /// Call before the write: a viewer on the same machine may read the frame before the call returns.
  void note_write(const Frame& frame);
  void note_first_write(FrameTimes& times);
  void count_sent(std::int64_t frames, std::int64_t bytes);
  /// Who cannot gets no frames for a while.
  void pay_for_output();
  void check_window();
  void block(Transport::Wait wait);
  void on_all_written();
  void close_now();
  void close_later();
  void log_failure(const std::exception& exception) noexcept;
  void ended();

  // What each delivery needs comes first, in few cache lines: outbox_ begins with its share.
  Context& context_;
  bool blocked_ = true;   ///< Nothing can be written: it is full, broken, ended or not yet open.
  bool closing_ = false;  ///< Only control messages are sent, then the close frame.
  bool window_check_due_ = false;
  const Frame* alone_ = nullptr;  ///< The last written past write_queue_; valid in sent().
  std::uint64_t frames_sent_ = 0;
  std::uint64_t bytes_sent_ = 0;
  std::uint64_t frames_paid_ = 0;  ///< Of those sent.
  std::uint64_t bytes_paid_ = 0;
  std::uint64_t joined_ = 0;   ///< Frames written behind others in one write, not paid yet; likewise:
  std::uint64_t offered_ = 0;  ///< Frames queued,
  std::uint64_t records_ = 0;  ///< and records of TLS.
  Transport transport_;
  ReaderWatch watch_;
  std::vector<Outbox::Item> write_queue_;  ///< Written next, in order.
  Outbox outbox_;
  GrantPtr grant_;
  websocket::MessageReader reader_;
  Bytes unread_;                      ///< Read, and not parsed before the pause.
  std::shared_ptr<void> unfinished_;  ///< Counts unfinished_bytes_: of reader_, unread_, the kernel, unread_answers().
  std::size_t unfinished_bytes_ = 0;
  std::size_t queued_bytes_ = 0;   ///< Size of write_queue_, the written part of its first item included.
  std::size_t partial_bytes_ = 0;  ///< Written bytes of the first item.
  std::string close_reason_;
  RateLimiter control_;
  double unpaid_us_ = 0;  ///< Of the frame that begins.
  double turn_us_ = 0;    ///< Work of this turn.
  double output_us_ = 0;  ///< Of joins, not paid yet.
  Asked reading_{50};     ///< Most begin with a subscription.
  Asked telling_{5};
  std::unique_ptr<Timer> pause_;     ///< While it has to wait for its turn.
  std::unique_ptr<Timer> deadline_;  ///< For closing.
  ConnectionCount counted_;
  TimeUs last_input_us_ = 0;
  TimeUs pinged_us_ = 0;  ///< Since the last input; 0: not.
  TimeUs opened_us_ = 0;
  std::uint64_t id_ = 0;
  websocket::CloseCode close_code_ = websocket::CloseCode::kNormal;
  bool close_queued_ = false;  ///< The close frame is in write_queue_ or written.
  bool open_ = false;
  bool ended_ = false;
  bool close_received_ = false;  ///< The peer's close frame, or an error that ends reading.
  bool greeted_ = false;         ///< The first messages are written.
  bool paused_ = false;          ///< Reading waits until answers are written, or for pause_.
};

inline void Connection::count_sent(std::int64_t frames, std::int64_t bytes) {
  context_.counters.frames_sent += static_cast<std::uint64_t>(frames);
  context_.counters.frame_bytes_sent += static_cast<std::uint64_t>(bytes);
  frames_sent_ += static_cast<std::uint64_t>(frames);
  bytes_sent_ += static_cast<std::uint64_t>(bytes);
}

template <typename Work>
void Connection::guarded(Work work) {
  try {
    work();
  } catch (const std::exception& exception) {
    log_failure(exception);
    blocked_ = true;
    close_later();
  }
}

}  // namespace eigencast::broker
