// SPDX-License-Identifier: MIT
#include "common/net/http.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>

#include "common/net/client_stream.h"
#include "common/net/websocket_failure.h"

namespace eigencast {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
using tcp = asio::ip::tcp;
using boost::system::error_code;
using Request = http::request<http::span_body<const std::uint8_t>>;

constexpr std::size_t kPieceBytes = 64 * 1024;
constexpr std::uint64_t kMaxRemarkBytes = 64 * 1024;

/// What a WebSocket's address answers to a client that may upgrade and does not.
constexpr int kUpgradeRequired = 426;

/// Where a response's body goes: pieces are appended to `body`, up to `max_bytes` in all.
struct Sink {
  Bytes* body = nullptr;  ///< Null: none is expected but what an error says.
  std::uint64_t max_bytes = 0;
  const std::function<void(std::uint64_t)>* progress = nullptr;
};

}  // namespace

class HttpConnection::Impl {
 public:
  Impl(const BrokerUrl& url, std::chrono::milliseconds timeout)
      : url_(url.at(0)), timeout_(timeout), where_(url_.origin()) {}

  Result<HttpResponse> exchange(Request& request, const Sink& wanted = {}) {
    if (url_.tls && !tls_) {
      if (const auto good = store(tls_, make_client_tls(url_)); !good) return good.error();
    }
    if (!url_.credentials.token.empty()) request.set(http::field::authorization, "Bearer " + url_.credentials.token);
    if (!url_.prefix.empty()) request.target(url_.prefix + std::string(request.target()));
    request.set(http::field::host, url_.authority());
    request.set(http::field::user_agent, "eigencast");
    request.set(http::field::accept, "application/json, */*;q=0.1");  // A stream's URL is its page, too.
    request.keep_alive(true);
    // A kept-alive connection may have been closed by the server meanwhile, which shows only when it is used.
    for (bool fresh = stream_ == nullptr;; fresh = true) {
      if (fresh)
        if (auto connected = connect(); !connected) return connected.error();
      bool answered = false;
      auto response = talk(request, wanted, answered);
      if (response) return response;
      stream_.reset();
      if (cancelled_) return stopped();
      if (fresh || answered || response.error().code != ErrorCode::kDisconnected) return response;
    }
  }

  void cancel() {
    cancelled_ = true;
    asio::post(io_, [this] {
      if (stream_) tcp().close();
    });
  }

 private:
  /// Runs what was started on io_ to its end.
  void run() {
    io_.restart();
    io_.run();
  }

  static Error stopped() { return fail(ErrorCode::kCancelled, "stopped by the caller"); }

  Error failure(const error_code& ec, const std::string& doing) const {
    if (cancelled_) return stopped();
    if (ec == beast::error::timeout)
      return fail(ErrorCode::kTimeout,
                  where_ + " was silent for " + std::to_string(timeout_.count()) + " ms while " + doing);
    return fail(
        ClientStream::wants_certificate(ec) ? ErrorCode::kRefused : ErrorCode::kDisconnected,
        "connection to " + where_ + " lost while " + doing + ": " + ec.message() + ClientStream::advice_on(ec, where_));
  }

  Result<void> connect() {
    if (cancelled_) return stopped();
    stream_ = std::make_unique<ClientStream>(io_.get_executor(), tls_);
    buffer_.clear();
    error_code ec;
    // On this thread: an asynchronous lookup would take one of its own, and could not be broken off either.
    const std::string& host = url_.address.empty() ? url_.host : url_.address;
    const auto endpoints = tcp::resolver(io_).resolve(host, std::to_string(url_.port), ec);
    if (ec) return give_up(fail(ErrorCode::kUnreachable, "host \"" + url_.host + "\" is not known: " + ec.message()));
    tcp().expires_after(timeout_);
    tcp().async_connect(endpoints, [&](error_code why, const tcp::endpoint&) { ec = why; });
    run();
    if (ec) return give_up(fail(ErrorCode::kUnreachable, "no broker at " + where_ + ": " + ec.message()));
    tcp().socket().set_option(tcp::no_delay(true), ec);
    tcp().expires_after(timeout_);
    stream_->async_secure(url_, [&](error_code why) { ec = why; });
    run();
    if (ec) return give_up(stream_->handshake_failure(url_, ec));
    return {};
  }

  beast::tcp_stream& tcp() { return stream_->next_layer(); }

  Error give_up(Error error) {
    stream_.reset();
    return cancelled_ ? stopped() : std::move(error);
  }

  Result<HttpResponse> talk(Request& request, const Sink& wanted, bool& answered) {
    const error_code sent = write(request);
    // A server that refuses an upload may answer and close before it has read all of it: its answer says why.
    http::response_parser<http::buffer_body> parser;
    parser.body_limit(boost::none);
    if (request.method() == http::verb::head) parser.skip(true);
    error_code ec;
    tcp().expires_after(timeout_);
    http::async_read_header(*stream_, buffer_, parser, [&](error_code why, std::size_t) { ec = why; });
    run();
    if (ec) return failure(sent ? sent : ec, sent ? "sending a request" : "waiting for an answer");
    answered = true;

    HttpResponse response;
    response.status = parser.get().result_int();
    const auto etag = parser.get()[http::field::etag];
    response.etag.assign(etag.data(), etag.size());
    if (parser.content_length()) response.content_length = *parser.content_length();
    if (request.method() != http::verb::head) {
      const bool is_wanted = wanted.body != nullptr && (response.status == 200 || response.status == 206);
      if (is_wanted && response.status == 200) wanted.body->clear();
      const Sink sink = is_wanted ? wanted : Sink{&response.body, kMaxRemarkBytes};
      if (auto read = read_body(parser, sink); !read) return read.error();
    }
    if (sent || !parser.get().keep_alive()) stream_.reset();
    return response;
  }

  error_code write(Request& request) {
    http::request_serializer<Request::body_type> serializer(request);
    error_code ec;
    while (!ec && !serializer.is_done()) {
      tcp().expires_after(timeout_);
      http::async_write_some(*stream_, serializer, [&](error_code why, std::size_t) { ec = why; });
      run();
    }
    return ec;
  }

  Result<void> read_body(http::response_parser<http::buffer_body>& parser, const Sink& sink) {
    const auto too_large = [&](std::uint64_t bytes) {
      return fail(ErrorCode::kTooLarge, where_ + " sent " + std::to_string(bytes) + " bytes or more where at most " +
                                            std::to_string(sink.max_bytes) + " are allowed");
    };
    if (parser.content_length() &&
        *parser.content_length() > sink.max_bytes - std::min<std::uint64_t>(sink.max_bytes, sink.body->size()))
      return too_large(sink.body->size() + *parser.content_length());
    std::array<std::uint8_t, kPieceBytes> piece;
    while (!parser.is_done()) {
      parser.get().body().data = piece.data();
      parser.get().body().size = piece.size();
      parser.get().body().more = true;
      error_code ec;
      tcp().expires_after(timeout_);
      http::async_read_some(*stream_, buffer_, parser, [&](error_code why, std::size_t) { ec = why; });
      run();
      if (ec == http::error::need_buffer) ec = {};
      // What came before a break is kept: the next request goes on behind it.
      const std::size_t count = piece.size() - parser.get().body().size;
      if (sink.body->size() + count > sink.max_bytes) return too_large(sink.body->size() + count);
      sink.body->insert(sink.body->end(), piece.begin(), piece.begin() + static_cast<std::ptrdiff_t>(count));
      if (count > 0 && sink.progress && *sink.progress) (*sink.progress)(sink.body->size());
      if (ec) return failure(ec, "reading an answer");
    }
    return {};
  }

  const BrokerUrl url_;
  const std::chrono::milliseconds timeout_;
  const std::string where_;
  std::atomic<bool> cancelled_{false};
  asio::io_context io_;
  ClientTls tls_;  ///< Made by the first request.
  std::unique_ptr<ClientStream> stream_;
  beast::flat_buffer buffer_{kPieceBytes * 2};
};

HttpConnection::HttpConnection(const BrokerUrl& url, std::chrono::milliseconds timeout)
    : impl_(std::make_unique<Impl>(url, timeout)) {}
HttpConnection::~HttpConnection() = default;

Result<HttpResponse> HttpConnection::get(const std::string& target, std::uint64_t max_bytes) {
  Bytes body;
  auto response = get_rest(target, max_bytes, body);
  if (response && response->body.empty()) response->body = std::move(body);
  return response;
}

Result<HttpResponse> HttpConnection::get_rest(const std::string& target, std::uint64_t max_bytes, Bytes& body,
                                              const std::function<void(std::uint64_t)>& progress) {
  Request request(http::verb::get, target, 11);
  if (!body.empty()) request.set(http::field::range, "bytes=" + std::to_string(body.size()) + "-");
  return impl_->exchange(request, {&body, max_bytes, &progress});
}

Result<HttpResponse> HttpConnection::head(const std::string& target) {
  Request request(http::verb::head, target, 11);
  return impl_->exchange(request);
}

Result<HttpResponse> HttpConnection::put(const std::string& target, ByteView body) {
  Request request(http::verb::put, target, 11);
  request.body() = boost::beast::span<const std::uint8_t>(body.data(), body.size());
  request.set(http::field::content_type, "application/octet-stream");
  request.content_length(body.size());
  return impl_->exchange(request);
}

void HttpConnection::cancel() {
  impl_->cancel();
}

namespace {

Result<void> probe_one(const BrokerUrl& url, const std::string& endpoint, std::chrono::milliseconds silence) {
  HttpConnection http(url, silence);
  const auto answer = http.get(endpoint, kMaxRemarkBytes);
  if (!answer) return answer.error();
  if (answer->status == kUpgradeRequired) return {};
  const std::string_view said(reinterpret_cast<const char*>(answer->body.data()), answer->body.size());
  WebSocketFailure failure =
      failure_of_answer(static_cast<unsigned>(answer->status), said, url.origin(), !url.credentials.token.empty());
  if (failure.min_wait < kHopelessRetry) failure.error.code = ErrorCode::kUnreachable;
  return failure.error;
}

}  // namespace

Result<void> probe(const BrokerUrl& url, const std::string& endpoint, std::chrono::milliseconds silence) {
  Result<void> answer;
  for (std::size_t i = 0; i < url.brokers(); ++i) {
    auto one = probe_one(url.at(i), endpoint, silence);
    if (one) return one;
    if (answer || answer.error().code != ErrorCode::kRefused) answer = std::move(one);
  }
  return answer;
}

}  // namespace eigencast
