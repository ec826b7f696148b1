// SPDX-License-Identifier: MIT
#include "broker/connections/connection.h"

#include <netinet/tcp.h>

#include <boost/beast/websocket/rfc6455.hpp>
#include <utility>

namespace eigencast::broker {
namespace {

namespace websocket = beast::websocket;

// The kernel takes no more than this beyond what is on its way, so that the newest pose waits here, where it can be
// replaced.
constexpr int kUnsentBytes = 16 * 1024;

constexpr std::size_t kReadBytes = 64 * 1024;

Outbox::Limits outbox_limits(const Config& config) {
  Outbox::Limits limits;
  limits.max_control_messages = static_cast<std::size_t>(config.limits.max_queued_control_messages);
  limits.max_control_bytes = static_cast<std::size_t>(config.limits.max_queued_control_bytes);
  limits.window_slack_us = config.frames.window_ms * 1000;
  return limits;
}

void tune(Socket& socket) {
  ErrorOf ignored;
  socket.set_option(Tcp::no_delay(true), ignored);
  using UnsentLimit = asio::detail::socket_option::integer<IPPROTO_TCP, TCP_NOTSENT_LOWAT>;
  socket.set_option(UnsentLimit(kUnsentBytes), ignored);
}

}  // namespace

Connection::Connection(Context& context, Socket socket, std::size_t max_binary_bytes)
    : context_(context),
      socket_(std::move(socket)),
      max_binary_bytes_(max_binary_bytes),
      outbox_(outbox_limits(context.config)),
      deadline_(context.loop.get_executor()) {
  tune(socket_.next_layer());
  socket_.auto_fragment(false);
  socket_.read_message_max(0);  // Counted in on_read(): Beast 1.81 resets the connection before its 1009 arrives.
  websocket::stream_base::timeout timeout{};
  timeout.handshake_timeout = std::chrono::milliseconds(context.config.timeouts.header_ms);
  timeout.idle_timeout = std::chrono::milliseconds(context.config.timeouts.idle_ms);
  timeout.keep_alive_pings = true;
  socket_.set_option(timeout);
}

void Connection::start(UpgradeRequest request) {
  socket_.set_option(
      websocket::stream_base::decorator([version = context_.version](websocket::response_type& response) {
        response.set(beast::http::field::server, "eigencast-broker/" + version);
        response.set(beast::http::field::sec_websocket_protocol,
                     beast::string_view(control::kSubprotocol.data(), control::kSubprotocol.size()));
      }));
  auto kept = std::make_shared<UpgradeRequest>(std::move(request));
  socket_.async_accept(*kept, [self = shared_from_this(), kept](ErrorOf error) {
    if (!error) self->guarded([&] { self->on_accepted(); });
  });
}

void Connection::on_accepted() {
  open_ = true;
  ++context_.counters.connections;
  ++context_.counters.connections_total;
  context_.connections.insert(this);
  send(control::Welcome{context_.version, context_.session_id, steady_now_us()});
  on_open();
  read();
  flush();
}

template <typename Work>
void Connection::guarded(Work work) {
  try {
    work();
  } catch (const std::exception& exception) {
    log_failure(exception);
    cut();
  }
}

void Connection::log_failure(const std::exception& exception) noexcept {
  try {
    log(context_.log, LogLevel::kError, label() + ": closed, the broker failed: " + exception.what());
  } catch (const std::exception&) {  // Not even memory for the line.
  }
}

void Connection::read() {
  socket_.async_read_some(buffer_, kReadBytes, [self = shared_from_this()](ErrorOf error, std::size_t) {
    self->guarded([&] { self->on_read(error); });
  });
}

void Connection::on_read(ErrorOf error) {
  if (error) return ended();
  const auto most =
      socket_.got_text() ? static_cast<std::size_t>(context_.config.limits.max_control_bytes) : max_binary_bytes_;
  if (!closing_ && buffer_.size() > most) {
    refuse(
        fail(ErrorCode::kTooLarge, "a message is over " + std::to_string(most) + " bytes, the most that is taken here"),
        {}, websocket::close_code::too_big);
  }
  if (!closing_ && socket_.is_message_done()) on_message();
  if (closing_ || socket_.is_message_done()) buffer_.consume(buffer_.size());
  read();
  flush();
}

void Connection::on_message() {
  const auto data = buffer_.cdata();
  if (socket_.got_text()) {
    on_text({static_cast<const char*>(data.data()), data.size()});
  } else {
    on_binary({static_cast<const std::uint8_t*>(data.data()), data.size()});
  }
}

void Connection::send(const ControlMessage& message) {
  if (closing_ || ended_) return;
  if (outbox_.push_control(std::make_shared<const std::string>(text_from_control(message)))) return flush();
  ++context_.counters.slow_disconnects;
  log(context_.log, LogLevel::kWarning, label() + ": closed, it does not take its control messages");
  closing_ = true;
  close_reason_ = {websocket::close_code::policy_error, "control messages are not taken"};
  // The owner may be in the middle of telling all its watchers something.
  asio::post(context_.loop, [self = shared_from_this()] { self->cut(); });
}

void Connection::send_droppable(const std::shared_ptr<const std::string>& text) {
  if (!closing_ && outbox_.push_droppable(text)) flush();
}

void Connection::flush() {
  try {
    write_next();
  } catch (const std::exception& exception) {
    // The caller may be in the middle of telling all its watchers something: the read that waits, or comes next, ends.
    log_failure(exception);
    ErrorOf ignored;
    socket_.next_layer().close(ignored);
  }
}

void Connection::write_next() {
  if (is_writing_ || !open_ || ended_ || close_sent_) return;
  auto item = outbox_.take(steady_now_us(), [this](std::uint32_t id) { return join_of(id); });
  if (!item || (closing_ && item->frame)) {
    if (closing_) close_now();
    return;
  }
  writing_ = std::move(*item);
  is_writing_ = true;
  auto done = [self = shared_from_this()](ErrorOf error, std::size_t) {
    self->guarded([&] { self->on_written(error); });
  };
  if (writing_.text) {
    ++context_.counters.control_sent;
    socket_.text(true);
    socket_.async_write(asio::buffer(*writing_.text), std::move(done));
  } else {
    ++context_.counters.frames_sent;
    context_.counters.frame_bytes_sent += writing_.frame->message.size();
    socket_.binary(true);
    socket_.async_write(asio::buffer(writing_.frame->message), std::move(done));
  }
}

void Connection::on_written(ErrorOf error) {
  is_writing_ = false;
  writing_ = {};
  if (error) return cut();
  flush();
}

void Connection::refuse(const Error& error, const std::string& stream, websocket::close_code code) {
  send(control::ErrorMessage{std::string(name_of(error.code)), error.message, stream});
  close_when_sent(error.message, code);
}

void Connection::refuse_text(const Error& error, const std::string& stream) {
  const bool unknown = error.code == ErrorCode::kUnsupported;
  if (unknown) return send(control::ErrorMessage{std::string(name_of(error.code)), error.message, stream});
  log(context_.log, LogLevel::kWarning, label() + ": closed, " + error.message);
  refuse(error, stream,
         error.code == ErrorCode::kTooLarge ? websocket::close_code::too_big : websocket::close_code::bad_payload);
}

void Connection::say_bye(const std::string& reason, std::uint32_t retry_after_ms, websocket::close_code code) {
  send(control::Bye{reason, retry_after_ms});
  close_when_sent(reason, code);
}

void Connection::close_when_sent(const std::string& reason, websocket::close_code code) {
  if (closing_) return;
  closing_ = true;
  close_reason_ = {code, beast::string_view(reason).substr(0, 120)};
  deadline_.expires_after(std::chrono::milliseconds(context_.config.timeouts.shutdown_ms));
  deadline_.async_wait([self = shared_from_this()](ErrorOf error) {
    if (!error) self->cut();
  });
  flush();
}

void Connection::close_now() {
  close_sent_ = true;
  socket_.async_close(close_reason_, [self = shared_from_this()](ErrorOf) { self->ended(); });
}

void Connection::cut() {
  ErrorOf ignored;
  socket_.next_layer().close(ignored);
  ended();
}

void Connection::ended() {
  if (ended_) return;
  ended_ = true;
  deadline_.cancel();
  --context_.counters.connections;
  context_.connections.erase(this);
  on_closed();
}

bool Connection::answer_common(const ControlMessage& message) {
  if (const auto* ping = std::get_if<control::Ping>(&message)) {
    send(control::Pong{ping->id, ping->time_us, steady_now_us()});
    return true;
  }
  return std::holds_alternative<control::Pong>(message);
}

Result<ControlMessage> Connection::parse(std::string_view text) {
  ++context_.counters.control_received;
  return control_from_text(text);
}

}  // namespace eigencast::broker
