// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/post.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "broker/access/gate.h"
#include "broker/context.h"

namespace eigencast::broker {

/// Fields of an answer's head.
using HttpHeaders = std::vector<std::pair<beast::http::field, std::string>>;

/// One HTTP/1.1 connection of the data port as far as it is bytes and time: the TLS handshake, one request head after
/// the other, answers, and a close that loses none of them. What is answered, on_head() decides. Kept alive by its
/// pending operations. Belongs to the first event loop.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  using Status = beast::http::status;
  using Parser = beast::http::request_parser<beast::http::buffer_body>;

  virtual ~HttpConnection();
  HttpConnection(const HttpConnection&) = delete;
  HttpConnection& operator=(const HttpConnection&) = delete;
  void start();

  Context& context() { return context_; }
  Transport& transport() { return transport_; }
  const IpAddress& peer() const { return peer_; }
  /// Of the request at hand, and the bytes that were read behind its head.
  Parser& parser() { return *parser_; }
  beast::flat_buffer& buffer() { return buffer_; }
  std::string header(beast::http::field field) const { return std::string(parser_->get()[field]); }
  bool is_head() const { return parser_->get().method() == beast::http::verb::head; }
  /// Whether another request may follow on this connection. Not with body bytes of this one unread: they would be
  /// taken for the next request.
  bool may_keep() const;

  /// Sends a whole answer; then comes the next request, or the end.
  void answer(Status status, std::string body, HttpHeaders headers = {});
  void answer_error(Status status, const Error& error, HttpHeaders headers = {});
  void answer_denial(const Denial& denial);

  // For those who send or read a body piece by piece.

  /// What every answer carries, and `headers`.
  void decorate(beast::http::fields& response, const HttpHeaders& headers);
  /// From now on, nothing but close() may take longer than this.
  void arm(std::int64_t timeout_ms);
  void disarm() { timer_.cancel(); }
  /// The answer is sent: on to the next request if `keep`, else the end.
  void finish(bool keep);
  void close();
  /// Does `work`, which gives a Result, on the disk's threads, then `then` with it on the loop: no read or write of a
  /// file ever holds up a frame. The connection lives on meanwhile. What must not end on the disk's threads, `then`
  /// holds, not `work`.
  template <typename Work, typename Then>
  void on_disk(Work work, Then then) {
    asio::post(context_.disk, [self = shared_from_this(), guard = asio::make_work_guard(context_.loop),
                               work = std::move(work), then = std::move(then)]() mutable {
      const auto kept = std::make_shared<decltype(work())>(guarded(work));
      asio::io_context& loop = self->context_.loop;
      // The connection goes along and comes back: it must not end on the disk's thread.
      asio::post(loop, [self = std::move(self), then = std::move(then), kept]() mutable { then(*kept); });
    });
  }

 protected:
  HttpConnection(Context& context, Transport transport);
  /// A request's head has come: answer it.
  virtual void on_head() = 0;

 private:
  /// An exception on the disk's threads would end the broker.
  template <typename Work>
  static auto guarded(Work& work) -> decltype(work()) {
    try {
      return work();
    } catch (const std::exception& exception) {
      return fail(ErrorCode::kIo, std::string("the disk's thread failed: ") + exception.what());
    }
  }

  void read_head();
  void drain();
  void drain_socket();

  Context& context_;
  Transport transport_;
  Timer timer_;
  beast::flat_buffer buffer_;
  std::optional<Parser> parser_;
  IpAddress peer_;
  std::vector<std::uint8_t> drained_;
  Seat seat_;
};

}  // namespace eigencast::broker
