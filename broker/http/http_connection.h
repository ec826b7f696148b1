// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/buffer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/access/gate.h"
#include "broker/context.h"

namespace eigencast::broker {

/// Fields of an answer's head, by name.
using HttpHeaders = std::vector<std::pair<std::string_view, std::string>>;

/// One HTTP/1.1 connection as far as it is bytes and time: the TLS handshake, one request head after the other,
/// answers, and a close that loses none of them. What is answered, on_head() decides. Kept alive by its pending
/// operations. Belongs to the first event loop. All of Beast's reading and writing is in its .cpp: it takes long to
/// compile.
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
  /// GET or HEAD.
  bool reads() const { return is_head() || parser_->get().method() == beast::http::verb::get; }
  /// Whether another request may follow on this connection. Not with body bytes of this one unread: they would be
  /// taken for the next request.
  bool may_keep() const;

  /// Sends a whole answer; then comes the next request, or the end. A body is JSON unless `headers` say what it is.
  void answer(Status status, std::string body, HttpHeaders headers = {});
  void answer_error(Status status, const Error& error, HttpHeaders headers = {});
  void answer_denial(const Denial& denial);

  // For those who send or read a body piece by piece.

  /// The head of an answer: `headers`, and what every answer carries.
  std::string head_of(Status status, HttpHeaders headers);
  /// Sends `bytes`, which the caller keeps, then goes on with `then`. If it cannot, the connection ends.
  void send(asio::const_buffer bytes, std::function<void()> then);
  /// Reads the body's next bytes until `into` is full or the body has ended; `then` is told how many. REQUIRES: the
  /// parser is not done.
  void read_body(std::span<std::uint8_t> into, std::function<void(ErrorOf, std::size_t)> then);
  /// From now on, nothing but close() may take longer than this.
  void arm(std::int64_t timeout_ms);
  void disarm() { timer_.cancel(); }
  /// The answer is sent: on to the next request if `keep`, else the end.
  void finish(bool keep);
  void close();
  /// Does `work`, which gives a Result, on the disk's threads, then `then` with it on the loop: no read or write of a
  /// file ever holds up a frame. The connection lives on meanwhile. What must not end on the disk's threads, `then`
  /// holds, not `work`. Both can be copied.
  template <typename Work, typename Then>
  void on_disk(Work work, Then then) {
    const auto outcome = std::make_shared<std::optional<decltype(work())>>();
    do_on_disk([outcome, work = std::move(work)]() mutable { outcome->emplace(guarded(work)); },
               [outcome, then = std::move(then)]() mutable { then(**outcome); });
  }

 protected:
  /// What requests may take.
  struct Limits {
    std::int64_t head_ms = 0;      ///< Until a whole head has come.
    std::int64_t transfer_ms = 0;  ///< Until an answer has left.
    std::uint64_t body_bytes = 0;
    const char* body_limit = "";  ///< The name of that limit.
    bool keeps = true;            ///< Whether a request may follow another.
  };

  HttpConnection(Context& context, Transport transport);
  /// Asked for each request.
  virtual Limits limits() const = 0;
  /// A request's head has come: answer it.
  virtual void on_head() = 0;
  /// Adds what every answer carries.
  virtual void decorate(HttpHeaders& headers) const = 0;
  const Context& context() const { return context_; }
  const Parser& parser() const { return *parser_; }

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

  void do_on_disk(std::function<void()> work, std::function<void()> then);
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
};

}  // namespace eigencast::broker
