// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <exception>
#include <memory>
#include <string>

#include "broker/context.h"
#include "broker/relay/outbox.h"

namespace eigencast::broker {

using UpgradeRequest = beast::http::request<beast::http::buffer_body>;

/// One WebSocket: reads messages, writes what its outbox decides, closes with a reason. Publisher and subscriber say
/// what the messages mean. Kept alive by its pending operations. Belongs to its event loop.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  virtual ~Connection() = default;
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Answers the upgrade and runs. `request` must have been checked for the subprotocol.
  void start(UpgradeRequest request);

  /// Sends "bye", then closes with `code`; what the peer does not take within timeouts.shutdown_ms is cut off.
  void say_bye(const std::string& reason, std::uint32_t retry_after_ms, beast::websocket::close_code code);

  /// Called once a second.
  virtual void on_tick() {}

 protected:
  /// Texts are held to limits.max_control_bytes.
  Connection(Context& context, Socket socket, std::size_t max_binary_bytes);

  virtual void on_open() = 0;
  virtual void on_text(std::string_view text) = 0;
  virtual void on_binary(ByteView message) = 0;
  /// Called once, when nothing more comes or goes. Not called if the upgrade failed.
  virtual void on_closed() = 0;
  virtual FramePtr join_of(std::uint32_t /*stream_id*/) { return nullptr; }
  virtual std::string label() const = 0;

  Context& context() { return context_; }
  Outbox& outbox() { return outbox_; }
  /// Queues a control message; a full queue closes the connection.
  void send(const ControlMessage& message);
  void send_droppable(const std::shared_ptr<const std::string>& text);
  /// Writes what the outbox has, unless a write is under way.
  void flush();
  /// Tells the peer what was wrong, then closes. Nothing of the peer is read any more.
  void refuse(const Error& error, const std::string& stream, beast::websocket::close_code code);
  /// Deals with a text that parse() refused: an unknown op is answered, anything else closes the connection.
  void refuse_text(const Error& error, const std::string& stream);
  bool is_closing() const { return closing_; }
  /// Pings and what nobody expects here; true if it was dealt with.
  bool answer_common(const ControlMessage& message);
  Result<ControlMessage> parse(std::string_view text);

 private:
  void on_accepted();
  void read();
  void on_read(ErrorOf error);
  void on_message();
  void write_next();
  void on_written(ErrorOf error);
  void close_when_sent(const std::string& reason, beast::websocket::close_code code);
  void close_now();
  void cut();
  /// Runs a handler's work. One that throws (no memory) costs its own connection, which leaves in good order.
  template <typename Work>
  void guarded(Work work);
  void log_failure(const std::exception& exception) noexcept;
  void ended();

  Context& context_;
  beast::websocket::stream<Socket> socket_;
  beast::flat_buffer buffer_;
  std::size_t max_binary_bytes_;
  Outbox outbox_;
  Outbox::Item writing_;
  beast::websocket::close_reason close_reason_;
  Timer deadline_;
  bool open_ = false;
  bool is_writing_ = false;
  bool closing_ = false;
  bool close_sent_ = false;
  bool ended_ = false;
};

}  // namespace eigencast::broker
