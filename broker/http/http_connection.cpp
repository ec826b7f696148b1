// SPDX-License-Identifier: MIT
#include "broker/http/http_connection.h"

#include <algorithm>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>

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
      peer_(peer_of(transport_.socket())),
      seat_(context.open) {
  ++context_.counters.connections_total;
}

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
  arm(context_.config.timeouts.header_ms);
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
  parser_->body_limit(static_cast<std::uint64_t>(context_.config.assets.max_object_bytes));
  arm(context_.config.timeouts.header_ms);
  http::async_read_header(transport_, buffer_, *parser_, [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (!error) return self->on_head();
    if (error == http::error::body_limit) {
      return self->answer_error(Status::payload_too_large,
                                fail(ErrorCode::kTooLarge, "the body is over assets.max_object_bytes"));
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
  return !body_unread && parser_->get().keep_alive();
}

void HttpConnection::decorate(http::fields& response, const HttpHeaders& headers) {
  for (const auto& [field, value] : headers) response.set(field, value);
  const std::string origin = header(http::field::origin);
  if (origin.empty()) return;
  response.insert(http::field::vary, "Origin");
  if (!context_.gate.policy()->allows_origin(access_request_from(parser_->get(), peer_, {}))) return;
  response.set(http::field::access_control_allow_origin, origin);
  response.set(http::field::access_control_expose_headers, "Accept-Ranges, Content-Range, ETag, Retry-After");
}

void HttpConnection::answer_denial(const Denial& denial) {
  log(context_.log, LogLevel::kInfo,
      "answered " + std::to_string(denial.status) + " to " + peer_.text() + ": " + denial.message);
  HttpHeaders headers;
  if (denial.status == 401) {
    headers.emplace_back(http::field::www_authenticate, denial.failed_login
                                                            ? "Bearer realm=\"eigencast\", error=\"invalid_token\""
                                                            : "Bearer realm=\"eigencast\"");
  }
  if (denial.retry_after_s > 0) headers.emplace_back(http::field::retry_after, std::to_string(denial.retry_after_s));
  answer_error(static_cast<Status>(denial.status), fail(ErrorCode::kRefused, denial.message), std::move(headers));
}

void HttpConnection::answer_error(Status status, const Error& error, HttpHeaders headers) {
  std::string body =
      "{\"error\":" + json_quoted(name_of(error.code)) + ",\"message\":" + json_quoted(error.message) + "}\n";
  answer(status, std::move(body), std::move(headers));
}

void HttpConnection::answer(Status status, std::string body, HttpHeaders headers) {
  const bool keep = may_keep();
  auto response = std::make_shared<http::response<http::string_body>>(status, 11);
  decorate(*response, headers);
  if (!body.empty()) response->set(http::field::content_type, "application/json");
  response->keep_alive(keep);
  response->body() = std::move(body);
  if (status != Status::not_modified && status != Status::no_content) response->prepare_payload();
  if (is_head()) response->body().clear();
  arm(context_.config.timeouts.transfer_ms);
  http::async_write(transport_, *response, [self = shared_from_this(), response, keep](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->finish(keep);
  });
}

void HttpConnection::finish(bool keep) {
  if (keep) return read_head();
  // Half-close, then read what still comes for a while: a close with unread bytes would reset the answer away.
  transport_.end_writing();
  arm(std::min<std::int64_t>(context_.config.timeouts.transfer_ms, kLongestDrainMs));
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
