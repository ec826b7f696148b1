// SPDX-License-Identifier: MIT
#pragma once

#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "broker/connections/transport.h"
#include "broker/connections/turn.h"
#include "broker/context.h"
#include "broker/operation/client_facts.h"
#include "broker/relay/outbox.h"
#include "broker/relay/reader_watch.h"
#include "broker/websocket/reader.h"

namespace eigencast::broker {

/// One WebSocket: reads messages, writes what its outbox decides, closes with a reason. Publisher and subscriber say
/// what the messages mean.
///
/// A peer that asks and does not take the answers is not read until it does.
///
/// What the outbox lets go waits for the end of the turn in `due_` and leaves in one write. While the socket takes less
/// than that, the connection is blocked: frames not begun go back to the outbox, which keeps the newest. Holds no read
/// buffer while idle. Kept alive by its pending operations. Belongs to its event loop.
class Connection : public std::enable_shared_from_this<Connection>, private Leaver {
 public:
  ~Connection() override = default;
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Sends `answer`, the head of the response to an upgrade that was checked, and runs.
  void start(std::string answer);

  /// Sends "bye", then closes with `code`; what the peer does not take within timeouts.shutdown_ms is cut off.
  void say_bye(const std::string& reason, std::uint32_t retry_after_ms, websocket::CloseCode code);

  /// It has been said bye to, or has said so: what is left is to be taken and to close.
  bool is_closing() const { return closing_; }

  /// What the admin API tells of it.
  virtual void describe(ClientFacts& facts) const;
  std::uint64_t id() const { return id_; }
  /// For logs: what it is, and its number in this run, as the admin API gives it.
  std::string name() const;

  /// Called once a second: pings the silent, cuts off the dead, sends away whose token has run out.
  void tick();

 protected:
  Connection(Context& context, Transport transport, GrantPtr grant, const websocket::MessageReader::Limits& limits);
  Connection(Context& context, Transport transport, GrantPtr grant, const websocket::MessageReader::Limits& limits,
             const Outbox::Limits& outbox);

  virtual void on_open() = 0;
  virtual void on_text(std::string_view text) = 0;
  virtual void on_binary(ByteView message) = 0;
  /// Called once, when nothing more comes or goes.
  virtual void on_closed() = 0;
  virtual void on_tick() {}
  /// The most that is read at a time: what one read asks, the control queue must be able to answer.
  virtual std::size_t read_bytes() const { return context_.read_buffer.size(); }
  virtual FramePtr join_of(std::uint32_t /*stream_id*/) { return nullptr; }
  virtual std::string label() const = 0;

  Context& context() { return context_; }
  /// What its peer may do.
  Grant& grant() { return *grant_; }
  Outbox& outbox() { return outbox_; }
  /// Says welcome.
  void greet();
  /// Queues a control message; a full queue closes the connection.
  void send(const ControlMessage& message);
  /// Queues a framed message; a full queue closes the connection.
  void send_framed(std::string message);
  /// Offers a stream's frames to the outbox; what it lets go leaves at once where nothing is gained by waiting.
  void deliver(std::uint32_t stream_id, std::span<const FramePtr> frames);
  void send_droppable(const Outbox::Text& text);
  /// What the outbox has leaves at the end of this turn, unless the connection is blocked.
  void flush();
  /// Tells the peer what was wrong, then closes. Nothing of the peer is read any more.
  void refuse(const Error& error, const std::string& stream, websocket::CloseCode code);
  /// Deals with a text that parse() refused: an unknown op is answered, anything else closes the connection.
  void refuse_text(const Error& error, const std::string& stream);
  /// Pings and what nobody expects here; true if it was dealt with.
  bool answer_common(const ControlMessage& message);
  Result<ControlMessage> parse(std::string_view text);
  /// Closes the WebSocket once all control messages have left.
  void close_when_sent(const std::string& reason, websocket::CloseCode code);

 private:
  // Leaver. None of these throws.
  void leave() override;
  int plain_socket() override;
  std::size_t pieces(std::span<iovec> out) override;
  void left(const Transport::Outcome& outcome) override;

  void wait_to_read(Transport::Wait wait);
  void on_readable();
  /// False: the connection has ended.
  bool take_input(std::span<std::uint8_t> input);
  void on_event(const websocket::MessageReader::Event& event);
  void on_ping(std::string_view payload);
  /// So many answers wait that no more questions are to be heard.
  bool is_overdue();
  /// Goes on reading where it was paused and answers have left.
  void read_on();
  void on_peer_closed(const websocket::MessageReader::Event& event);
  void on_broken(const websocket::MessageReader::Event& event);
  /// Nothing stands before a frame: it may go straight to the socket if the outbox lets it pass.
  bool leaves_at_once() const;
  /// By the outbox.
  void deliver_in_turn(std::uint32_t stream_id, std::span<const FramePtr> frames);
  void left_in_part(const FramePtr& frame, const Transport::Outcome& outcome);
  void gather();
  void drop_sent(std::size_t bytes);
  /// Before the kernel has it: a viewer on this machine may read it before the call returns.
  void note_leaving(const Frame& frame);
  void count_sent(std::size_t bytes);
  /// Looks whether a peer that does not acknowledge still reads.
  void look();
  void block(Transport::Wait wait);
  void all_left();
  void cut();
  void cut_later();
  /// Runs a handler's work. One that throws (no memory) costs its own connection, which leaves in good order.
  template <typename Work>
  void guarded(Work work);
  void log_failure(const std::exception& exception) noexcept;
  void ended();

  Context& context_;
  GrantPtr grant_;
  Transport transport_;
  websocket::MessageReader reader_;
  Outbox outbox_;
  ReaderWatch watch_;
  std::vector<Outbox::Item> due_;  ///< Leaves next, in this order.
  std::size_t due_bytes_ = 0;      ///< Of all of it, also what has left of the first.
  std::size_t first_left_ = 0;     ///< Bytes of the first that have left.
  std::string close_reason_;
  std::unique_ptr<Timer> deadline_;  ///< Of closing.
  Seat seat_;
  TimeUs heard_us_ = 0;
  TimeUs opened_us_ = 0;
  std::uint64_t id_ = 0;
  std::uint64_t frames_sent_ = 0;
  std::uint64_t bytes_sent_ = 0;
  websocket::CloseCode close_code_ = websocket::CloseCode::kNormal;
  bool pinged_ = false;  ///< Since it was heard last.
  bool open_ = false;
  bool blocked_ = false;
  bool closing_ = false;     ///< Only control messages leave, then the close frame.
  bool close_due_ = false;   ///< The close frame is in due_ or has left.
  bool close_came_ = false;  ///< The peer's, or something that ends the reading as well.
  bool ended_ = false;
  bool greeted_ = false;  ///< What comes first has left.
  bool look_due_ = false;
  bool paused_ = false;  ///< Nothing is read until answers have left.
};

template <typename Work>
void Connection::guarded(Work work) {
  try {
    work();
  } catch (const std::exception& exception) {
    log_failure(exception);
    blocked_ = true;
    cut_later();
  }
}

}  // namespace eigencast::broker
