// SPDX-License-Identifier: MIT
#include "broker/http/http_connection.h"

#include <algorithm>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/http/read.hpp>

#include "broker/http/access_facts.h"
#include "broker/http/http_target.h"

namespace eigencast::broker {
namespace {

namespace http = beast::http;

constexpr std::size_t kMaxHeadBytes = 16 * 1024;
constexpr std::int64_t kLongestDrainMs = 2'000;

/// Errors of the parser: the peer speaks no HTTP. Not those of a peer that went away.
bool is_no_http(ErrorOf error) {
  return error.category() == http::make_error_code(http::error::end_of_stream).category() &&
         error != http::error::end_of_stream && error != http::error::partial_message;
}

}  // namespace

HttpConnection::HttpConnection(Context& context, Transport transport)
    : context_(context),
      transport_(std::move(transport)),
      timer_(context.loop.get_executor()),
      peer_(peer_of(transport_.socket())) {}

HttpConnection::~HttpConnection() = default;

void HttpConnection::arm(std::int64_t timeout_ms) {
  timer_.expires_after(std::chrono::milliseconds(timeout_ms));
  timer_.async_wait([self = weak_from_this()](ErrorOf error) {
    if (auto connection = self.lock(); connection && !error) connection->close();
  });
}

void HttpConnection::close() {
  timer_.cancel();
  transport_.close();
}

void HttpConnection::start() {
  if (!transport_.is_tls()) return read_head();
  arm(limits().head_ms);
  transport_.async_handshake([self = shared_from_this()](ErrorOf error) {
    if (!error) return self->read_head();
    // A close with unread bytes would reset away the alert that says what was wrong.
    self->transport_.end_writing();
    self->drain_socket();
  });
}

void HttpConnection::read_head() {
  parser_.emplace();
  parser_->header_limit(kMaxHeadBytes);
  parser_->body_limit(limits().body_bytes);
  arm(limits().head_ms);
  http::async_read_header(transport_, buffer_, *parser_, [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (!error) return self->on_head();
    if (error == http::error::body_limit) {
      return self->answer_error(Status::payload_too_large, fail(ErrorCode::kTooLarge, std::string("the body is over ") +
                                                                                          self->limits().body_limit));
    }
    if (error == http::error::header_limit) {
      return self->answer_error(Status::request_header_fields_too_large,
                                fail(ErrorCode::kTooLarge, "the request head is over 16 KiB"));
    }
    if (is_no_http(error)) {
      return self->answer_error(Status::bad_request,
                                fail(ErrorCode::kCorrupt, "not an HTTP request: " + error.message()));
    }
    self->close();
  });
}

bool HttpConnection::may_keep() const {
  const bool body_unread = !parser_->is_header_done() ||
                           (!parser_->is_done() && (parser_->content_length().value_or(0) > 0 || parser_->chunked()));
  return !body_unread && limits().keeps && parser_->get().keep_alive();
}

void HttpConnection::answer_denial(const Denial& denial) {
  log(context_.log, LogLevel::kInfo,
      "answered " + std::to_string(denial.status) + " to " + peer_.text() + ": " + denial.message);
  HttpHeaders headers;
  if (denial.status == 401) {
    headers.emplace_back("WWW-Authenticate", denial.failed_login ? "Bearer realm=\"eigencast\", error=\"invalid_token\""
                                                                 : "Bearer realm=\"eigencast\"");
  }
  if (denial.retry_after_s > 0) headers.emplace_back("Retry-After", std::to_string(denial.retry_after_s));
  answer_error(static_cast<Status>(denial.status), fail(ErrorCode::kRefused, denial.message), std::move(headers));
}

void HttpConnection::answer_error(Status status, const Error& error, HttpHeaders headers) {
  std::string body =
      "{\"error\":" + json_quoted(name_of(error.code)) + ",\"message\":" + json_quoted(error.message) + "}\n";
  answer(status, std::move(body), std::move(headers));
}

void HttpConnection::answer(Status status, std::string body, HttpHeaders headers) {
  const bool keep = may_keep();
  const bool bodiless = status == Status::not_modified || status == Status::no_content;
  const auto is_type = [](const auto& field) { return field.first == "Content-Type"; };
  if (!body.empty() && std::none_of(headers.begin(), headers.end(), is_type)) {
    headers.emplace_back("Content-Type", "application/json");
  }
  if (!bodiless) headers.emplace_back("Content-Length", std::to_string(body.size()));
  const auto text = std::make_shared<std::string>(head_of(status, std::move(headers)));
  if (!bodiless && !is_head()) *text += body;
  arm(limits().transfer_ms);
  send(asio::buffer(*text), [this, text, keep] { finish(keep); });
}

std::string HttpConnection::head_of(Status status, HttpHeaders headers) {
  decorate(headers);
  if (!may_keep()) headers.emplace_back("Connection", "close");
  const auto reason = http::obsolete_reason(status);
  std::string text = "HTTP/1.1 " + std::to_string(static_cast<unsigned>(status)) + " ";
  text.append(reason.data(), reason.size()).append("\r\n");
  for (const auto& [name, value] : headers) text.append(name).append(": ").append(value).append("\r\n");
  return text + "\r\n";
}

void HttpConnection::send(asio::const_buffer bytes, std::function<void()> then) {
  asio::async_write(transport_, bytes, [self = shared_from_this(), then = std::move(then)](ErrorOf error, std::size_t) {
    if (error) return self->close();
    then();
  });
}

void HttpConnection::read_body(std::span<std::uint8_t> into, std::function<void(ErrorOf, std::size_t)> then) {
  auto& body = parser_->get().body();
  body.data = into.data();
  body.size = into.size();
  http::async_read(transport_, buffer_, *parser_,
                   [self = shared_from_this(), most = into.size(), then = std::move(then)](ErrorOf error, std::size_t) {
                     const std::size_t count = most - self->parser_->get().body().size;
                     then(error == http::error::need_buffer ? ErrorOf() : error, count);
                   });
}

void HttpConnection::do_on_disk(std::function<void()> work, std::function<void()> then) {
  asio::post(context_.disk, [self = shared_from_this(), guard = asio::make_work_guard(context_.loop),
                             work = std::move(work), then = std::move(then)]() mutable {
    work();
    work = nullptr;
    asio::io_context& loop = self->context_.loop;
    // The connection goes along and comes back: it must not end on the disk's thread.
    asio::post(loop, [self = std::move(self), then = std::move(then)] { then(); });
  });
}

void HttpConnection::finish(bool keep) {
  if (keep) return read_head();
  // Half-close, then read what still comes for a while: a close with unread bytes would reset the answer away.
  transport_.end_writing();
  arm(std::min(limits().transfer_ms, kLongestDrainMs));
  drain();
}

void HttpConnection::drain() {
  drained_.resize(kMaxHeadBytes);
  transport_.async_read_some(asio::buffer(drained_), [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->drain();
  });
}

void HttpConnection::drain_socket() {
  drained_.resize(kMaxHeadBytes);
  transport_.socket().async_read_some(asio::buffer(drained_), [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->drain_socket();
  });
}

}  // namespace eigencast::broker
