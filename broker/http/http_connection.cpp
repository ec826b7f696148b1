// SPDX-License-Identifier: MIT
#include "broker/http/http_connection.h"

#include <algorithm>
#include <array>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <nlohmann/json.hpp>

#include "broker/sockets/disk_threads.h"

namespace eigencast::broker {
namespace {

namespace beast = boost::beast;
namespace http = beast::http;

constexpr std::size_t kMaxHeadBytes = 16 * 1024;
constexpr int kMaxFields = 100;
/// A buffer that has grown twofold, and the fields.
constexpr std::size_t kLargeHeadBytes = 3 * kMaxHeadBytes;
/// What OpenSSL allocates for a ClientHello once its header says that it is as long as can be.
constexpr std::size_t kHandshakeBytes = 160 * 1024;
/// A client's last flight. Keys of its certificates are decoded before these are checked: usual ones in 500 us, the
/// worst that fit in 5,000, so that they cost more where the handshake fails.
constexpr double kFinishUs = 60, kCertificatesUs = 2'000, kRefusalUs = 20'000;
constexpr std::size_t kMaxReadBytes = 2 * kMaxHeadBytes;
constexpr std::int64_t kMaxDrainMs = 2'000;
constexpr TimeUs kMaxReadWaitUs = 2'000'000;
constexpr beast::string_view kForwardedPrefix = "X-Forwarded-";
/// What the kernel holds at most of answers that a peer does not acknowledge, so that crowds at one address have room;
/// wide for who comes first: with a round trip of 100 ms some 5 MB a second.
constexpr std::size_t kSegmentBytes = 64 * 1024, kNarrowBytes = 2 * kSegmentBytes, kWideBytes = 1024 * 1024;
constexpr double kWidePart = 0.5;  ///< Of what its holder may have: the rest is for those who come later.
/// Twice what sending takes on one core of 2026.
constexpr double kPieceUs = 5, kPlainBytesPerUs = 2'000, kTlsBytesPerUs = 1'000;

int buffer_for(std::size_t held) {
  return static_cast<int>((held - kSegmentBytes) / 2);
}

/// Parser errors, except those of a peer that went away.
bool is_malformed_request(ErrorOf error) {
  return error.category() == http::make_error_code(http::error::end_of_stream).category() &&
         error != http::error::end_of_stream && error != http::error::partial_message;
}

/// Refuses heads of many fields, each of which takes some 80 bytes beside its own.
class RequestParser final : public http::request_parser<http::buffer_body> {
  void on_field_impl(http::field name, beast::string_view text, beast::string_view value, ErrorOf& error) override {
    if (++fields_ > kMaxFields) return void(error = http::error::header_limit);
    get().insert(name, text, value);
  }

  int fields_ = 0;
};

}  // namespace

IpAddress peer_of(const Socket& socket) {
  ErrorOf gone;
  const auto endpoint = socket.remote_endpoint(gone);
  return gone ? IpAddress{} : IpAddress::from_text(endpoint.address().to_string()).value_or(IpAddress{});
}

/// What Beast reads from: the transport, at the pace that the budget allows.
struct HttpConnection::Wire {
  using executor_type = Transport::executor_type;
  explicit Wire(HttpConnection& owner) : connection(owner) {}
  executor_type get_executor() const { return connection.transport_.get_executor(); }

  template <typename Buffers, typename Handler>
  auto async_read_some(const Buffers& buffers, Handler&& handler) {
    enum class Step { kRead, kPace, kEnd };
    return asio::async_compose<Handler, void(ErrorOf, std::size_t)>(
        [&on = connection, buffers, step = Step::kRead, result = ErrorOf(), count = std::size_t{0}](
            auto& self, ErrorOf error = {}, std::size_t bytes = 0) mutable {
          if (step == Step::kRead) {
            step = Step::kPace;
            return on.transport_.async_read_some(buffers, std::move(self));
          }
          if (step == Step::kPace) {
            step = Step::kEnd;
            result = error;
            count = bytes;
            if (Timer* const pace = error ? nullptr : on.pace()) return pace->async_wait(std::move(self));
          }
          if (!on.transport_.socket().is_open()) result = asio::error::operation_aborted;
          self.complete(result, count);
        },
        handler, connection.transport_);
  }

  HttpConnection& connection;
  beast::flat_buffer buffer;
  std::optional<RequestParser> parser;
  std::size_t head_bytes = 0;
  std::uint64_t chunks = 0;
  std::function<void(std::uint64_t, beast::string_view, ErrorOf&)> on_chunk = [this](std::uint64_t, beast::string_view,
                                                                                     ErrorOf&) { ++chunks; };
};

HttpConnection::HttpConnection(Context& context, Transport transport)
    : context_(context),
      transport_(std::move(transport)),
      timer_(context.loop.get_executor()),
      wire_(std::make_unique<Wire>(*this)),
      peer_(peer_of(transport_.socket())) {
  transport_.limit_unsent(kSegmentBytes);
}

HttpConnection::~HttpConnection() = default;

std::string_view HttpConnection::method() const {
  return wire_->parser->get().method_string();
}

std::string_view HttpConnection::target() const {
  return wire_->parser->get().target();
}

std::string HttpConnection::header(std::string_view name) const {
  return std::string(wire_->parser->get()[name]);
}

std::string HttpConnection::joined_headers(std::string_view name) const {
  std::string all;
  const auto range = wire_->parser->get().equal_range(name);
  for (auto it = range.first; it != range.second; ++it) all.append(all.empty() ? "" : ",").append(it->value());
  return all;
}

std::optional<std::uint64_t> HttpConnection::content_length() const {
  const auto length = wire_->parser->content_length();
  return length ? std::optional<std::uint64_t>(*length) : std::nullopt;
}

AccessRequest HttpConnection::access_request(std::string query_token) const {
  const auto& fields = wire_->parser->get();
  const bool others = std::any_of(fields.begin(), fields.end(), [](const auto& field) {
    return beast::iequals(field.name_string().substr(0, kForwardedPrefix.size()), kForwardedPrefix) ||
           field.name() == http::field::via || beast::iequals(field.name_string(), "X-Real-IP");
  });
  // All fields of the forwarded: one that a client sent must not hide those that a proxy added.
  return {.peer = peer_,
          .authorization = header("Authorization"),
          .query_token = std::move(query_token),
          .origin = header("Origin"),
          .host = header("Host"),
          .forwarded_host = header("X-Forwarded-Host"),
          .forwarded = {.x_forwarded_for = joined_headers("X-Forwarded-For"),
                        .forwarded = joined_headers("Forwarded"),
                        .others = others}};
}

bool HttpConnection::is_websocket_upgrade() const {
  return beast::websocket::is_upgrade(wire_->parser->get()) && wire_->buffer.size() == 0;
}

bool HttpConnection::is_head_read() const {
  return wire_->parser && wire_->parser->is_header_done();
}

bool HttpConnection::has_body() const {
  return wire_->parser->chunked() || content_length().value_or(0) > 0;
}

bool HttpConnection::is_body_read() const {
  return wire_->parser->is_done();
}

/// RFC 9112, 3.2.
bool HttpConnection::names_one_host() const {
  const auto& request = wire_->parser->get();
  const auto hosts = request.count(http::field::host);
  return hosts == 0 ? request.version() < 11 : hosts == 1 && host_of_authority(header("Host"));
}

std::size_t HttpConnection::head_bytes() const {
  return wire_->head_bytes;
}

std::uint64_t HttpConnection::body_chunks() const {
  return wire_->chunks;
}

bool HttpConnection::has_unknown_coding() const {
  return wire_->parser->get().count("Transfer-Encoding") > 0 &&
         !beast::iequals(joined_headers("Transfer-Encoding"), "chunked");
}

bool HttpConnection::is_body_limit(ErrorOf error) {
  return error == http::error::body_limit;
}

void HttpConnection::arm(std::int64_t timeout_ms) {
  timer_.expires_after(std::chrono::milliseconds(timeout_ms));
  const std::size_t left = output_ ? transport_.unacknowledged() : 0;
  timer_.async_wait([self = weak_from_this(), timeout_ms, left](ErrorOf error) {
    const auto connection = self.lock();
    if (error || !connection) return;
    const bool takes = left > 0 && connection->transport_.unacknowledged() <= left - (left + 3) / 4;
    takes && !connection->is_writing_ ? connection->arm(timeout_ms) : connection->close();
  });
}

void HttpConnection::later(TimeUs wait_us, std::function<void()> then) {
  if (wait_us <= 0) return then();
  run_after(timer_, std::chrono::microseconds(wait_us),
            [self = shared_from_this(), then = std::move(then)] { then(); });
}

void HttpConnection::close() {
  timer_.cancel();
  if (pace_) pace_->cancel();
  if (settling_) settling_->cancel();
  output_ ? transport_.reset() : transport_.close();
}

void HttpConnection::start() {
  if (!transport_.is_tls()) return read_head();
  arm(limits().head_ms);
  transport_.async_wait(Transport::Wait::kReadable, [self = shared_from_this()](ErrorOf error) {
    // Before any cryptography: a copied ClientHello costs its sender nothing, and the broker a signature.
    const double work_us = self->transport_.handshake_us();
    const auto wait_us = error ? std::nullopt : self->take_work(work_us, self->limits().head_ms * 1000);
    if (!wait_us) return self->close();
    self->arm(self->limits().head_ms + *wait_us / 1000);
    const auto begin = [self] { self->begin_handshake(); };
    // The turn comes last: memory that many wait for may be given back at once.
    if (self->take_turn(work_us, *wait_us, begin, [self] { return self->hold_handshake(); })) begin();
  });
}

LoopShare::Supply HttpConnection::hold_handshake() {
  if (!transport_.socket().is_open()) return LoopShare::Supply::kGone;
  if (!store(unfinished_, hold_bytes(kHandshakeBytes))) return LoopShare::Supply::kShort;
  disarm();
  return LoopShare::Supply::kHeld;
}

void HttpConnection::begin_handshake() {
  if (!transport_.socket().is_open()) return;
  arm(limits().head_ms);
  shake_hands();
}

void HttpConnection::shake_hands() {
  const Transport::Outcome outcome = transport_.shake_hands();
  if (outcome.wait != Transport::Wait::kNo) {
    return transport_.async_wait(outcome.wait, [self = shared_from_this()](ErrorOf error) {
      if (error) return self->close();
      const auto go_on = [self](ErrorOf) { self->transport_.socket().is_open() ? self->shake_hands() : self->close(); };
      const double flight_us = self->transport_.asks_for_certificates() ? kCertificatesUs : kFinishUs;
      if (Timer* const pace = self->pace(flight_us)) return pace->async_wait(go_on);
      go_on({});
    });
  }
  if (!outcome.error) return read_head();
  if (transport_.asks_for_certificates()) {
    (void)take_work(kRefusalUs, kForeverUs);
    (void)take_turn(kRefusalUs, 0, [] {});
  }
  // Closing with unread bytes sends a reset, which would discard the TLS alert.
  transport_.end_writing();
  drain(transport_.socket());
}

Timer* HttpConnection::pace(double more_us) {
  const double work_us = more_us + kReadUs * static_cast<double>(std::max<std::size_t>(transport_.take_records(), 1));
  // Those over their budget do not wake together.
  const auto spread_us = static_cast<TimeUs>(reinterpret_cast<std::uintptr_t>(this) / 64 % (kMaxReadWaitUs / 2));
  TimeUs wait_us = take_work(work_us, kMaxReadWaitUs).value_or(kMaxReadWaitUs - spread_us);
  if (wait_us > 0) wait_us = std::max(wait_us, take_work(kPauseUs, kMaxReadWaitUs).value_or(0));
  const auto end_pause = [weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->pace_->cancel();
  };
  if (take_turn(work_us, wait_us, end_pause)) return nullptr;
  pace_ = std::make_unique<Timer>(context_.loop.get_executor(), Timer::time_point::max());
  return pace_.get();
}

void HttpConnection::read_head() {
  auto& parser = wire_->parser.emplace();
  parser.header_limit(kMaxHeadBytes);
  parser.body_limit(limits().body_bytes);
  parser.on_chunk_header(wire_->on_chunk);
  wire_->head_bytes = 0;
  wire_->chunks = 0;
  unfinished_.reset();
  if (wire_->buffer.capacity() > Grant::kFreeBytes) wire_->buffer.shrink_to_fit();
  wire_->buffer.max_size(Grant::kFreeBytes);
  // What the peer has not taken of the answer before has that one's time.
  arm(output_ ? std::max(limits().head_ms, limits().transfer_ms) : limits().head_ms);
  read_more_head();
}

void HttpConnection::read_more_head() {
  http::async_read_header(*wire_, wire_->buffer, *wire_->parser,
                          [self = shared_from_this()](ErrorOf error, std::size_t bytes) {
                            self->wire_->head_bytes += bytes;
                            self->on_head_read(error);
                          });
}

void HttpConnection::on_head_read(ErrorOf error) {
  if (error == http::error::buffer_overflow && !unfinished_) {
    if (const auto held = store(unfinished_, hold_bytes(kLargeHeadBytes)); !held) {
      return answer_limit(held.error().message);
    }
    wire_->buffer.max_size(kMaxReadBytes);
    return read_more_head();
  }
  if (!error && has_unknown_coding()) {
    return answer_error(HttpStatus::kNotImplemented,
                        fail(ErrorCode::kUnsupported, "the only Transfer-Encoding that this broker knows is chunked"));
  }
  if (!error && !names_one_host()) {
    return answer_denial({400, "send one Host header, NAME or ADDRESS, with :PORT or without, not '" +
                                   joined_headers("Host").substr(0, 64) + "'"});
  }
  if (!error) return on_head();
  if (is_body_limit(error)) {
    return answer_error(HttpStatus::kPayloadTooLarge,
                        fail(ErrorCode::kTooLarge, std::string("the body is over ") + limits().body_limit));
  }
  if (error == http::error::header_limit) {
    return answer_error(HttpStatus::kHeaderFieldsTooLarge,
                        fail(ErrorCode::kTooLarge, "the request head is over 16 KiB, or 100 fields"));
  }
  if (is_malformed_request(error)) {
    return answer_error(HttpStatus::kBadRequest, fail(ErrorCode::kCorrupt, "not an HTTP request: " + error.message()));
  }
  error == http::error::end_of_stream || error == asio::error::eof ? end() : close();
}

bool HttpConnection::can_keep_alive() const {
  const auto& parser = *wire_->parser;
  if (!parser.is_header_done() || !limits().keeps || !parser.get().keep_alive()) return false;
  if (has_unknown_coding() || !names_one_host()) return false;
  if (parser.chunked() && parser.get().version() < 11) return false;  // RFC 9112, 6.1: its framing is faulty.
  return parser.is_done() || !has_body();
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
  answer_error(static_cast<HttpStatus>(denial.status), fail(ErrorCode::kRefused, denial.message), std::move(headers));
}

void HttpConnection::answer_error(HttpStatus status, const Error& error, HttpHeaders headers) {
  const nlohmann::ordered_json body{{"error", name_of(error.code)}, {"message", error.message}};
  answer(status, body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n", std::move(headers));
}

void HttpConnection::refuse_method(const char* why, const char* allowed) {
  answer_error(HttpStatus::kMethodNotAllowed, fail(ErrorCode::kUnsupported, why), {{"Allow", allowed}});
}

void HttpConnection::answer(HttpStatus status, std::string body, HttpHeaders headers) {
  const auto owner = std::make_shared<const std::string>(std::move(body));
  answer_with(status, *owner, owner, std::move(headers));
}

void HttpConnection::answer_with(HttpStatus status, std::string_view body, std::shared_ptr<const void> owner,
                                 HttpHeaders headers) {
  const std::size_t memory = owner ? body.size() : 0;
  const auto next = [body, owner = std::move(owner)](const std::function<void(std::string_view)>& then) mutable {
    const std::string_view piece = body.substr(0, kPieceBytes);
    body.remove_prefix(piece.size());
    then(piece);
  };
  answer_from(status, body.size(), memory, next, std::move(headers));
}

/// An answer on its way.
struct HttpConnection::Outgoing {
  std::string head;
  std::uint64_t left;  ///< Of the body.
  Source source;
  std::shared_ptr<void> counted;  ///< In answers_now.
};

void HttpConnection::answer_from(HttpStatus status, std::uint64_t size, std::size_t memory, Source source,
                                 HttpHeaders headers) {
  const bool bodiless = status == HttpStatus::kNotModified || status == HttpStatus::kNoContent;
  const std::uint64_t to_send = bodiless || method() == "HEAD" ? 0 : size;
  if (!begin_output(to_send, to_send > 0 ? memory : 0)) return;
  const auto is_type = [](const auto& field) { return field.first == "Content-Type"; };
  if (size > 0 && std::none_of(headers.begin(), headers.end(), is_type)) {
    headers.emplace_back("Content-Type", "application/json");
  }
  if (!bodiless) headers.emplace_back("Content-Length", std::to_string(size));
  ++context_.counters.answers_now;
  const std::shared_ptr<void> counted(&context_, [&context = context_](void*) { --context.counters.answers_now; });
  send_rest(
      std::make_shared<Outgoing>(Outgoing{head_of(status, std::move(headers)), to_send, std::move(source), counted}));
}

bool HttpConnection::begin_output(std::uint64_t size, std::size_t memory) {
  const std::size_t left = transport_.unacknowledged();
  const std::uint64_t in_kernel = size + left;
  auto held = hold_bytes(memory + std::min<std::uint64_t>(in_kernel, kNarrowBytes));
  if (!held) {
    size > Grant::kFreeBytes ? answer_limit(held.error().message) : close();
    return false;
  }
  answers_ = true;
  output_ = std::move(*held);
  if (left <= kNarrowBytes) wide_.reset();
  is_long_ = in_kernel > kNarrowBytes && !wide_;
  if (is_long_) transport_.limit_send_buffer(buffer_for(kNarrowBytes));
  return true;
}

void HttpConnection::widen() {
  if (!is_long_ || !store(wide_, hold_bytes(kWideBytes - kNarrowBytes, kWidePart))) return;
  is_long_ = false;
  transport_.limit_send_buffer(buffer_for(kWideBytes));
}

void HttpConnection::widen_receive_buffer() {
  transport_.widen_receive_buffer(hold_wide(Transport::kWideBytes));
}

void HttpConnection::send_rest(const std::shared_ptr<Outgoing>& out) {
  const auto send_piece = [self = shared_from_this(), out](std::string_view piece) {
    out->left -= piece.size();
    const auto then = [self, out] {
      out->head.clear();
      self->send_rest(out);
    };
    if (piece.size() > Grant::kFreeBytes) return self->send_in_turn(out->head, piece, then);
    self->arm(self->limits().transfer_ms);
    self->send(out->head, piece, then);
  };
  if (out->left > 0) return out->source(send_piece);
  out->head.empty() ? finish(can_keep_alive()) : send_piece({});
}

void HttpConnection::send_in_turn(std::string_view head, std::string_view body, std::function<void()> then) {
  const auto bytes = static_cast<double>(head.size() + body.size());
  const double us = kPieceUs + bytes / (transport_.is_tls() ? kTlsBytesPerUs : kPlainBytesPerUs);
  const auto go = [self = shared_from_this(), head, body, then = std::move(then)] {
    if (!self->transport_.socket().is_open()) return;
    self->widen();
    self->arm(self->limits().transfer_ms);
    self->send(head, body, then);
  };
  disarm();
  if (take_turn(us, take_sending(us), go)) go();
}

void HttpConnection::settle() {
  if (!output_ || answers_) return;
  if (transport_.unacknowledged() == 0) {
    output_.reset();
    wide_.reset();
    if (ends_) close();
    return;
  }
  if (!settling_) settling_ = std::make_unique<Timer>(context_.loop.get_executor());
  settle_us_ = next_settle_us(settle_us_);
  const TimeUs wait_us = std::max(settle_us_, take_work(kReadUs, kMaxReadWaitUs).value_or(kMaxReadWaitUs));
  run_after(*settling_, std::chrono::microseconds(wait_us), [self = shared_from_this()] {
    const auto go = [self] { self->settle(); };
    // Closed, or a WebSocket by now, whose payer has gone with it.
    if (self->transport_.socket().is_open() && self->take_turn(kReadUs, 0, go)) go();
  });
}

void HttpConnection::end() {
  if (!output_) return close();
  ends_ = true;
  transport_.end_writing();
  arm(limits().transfer_ms);
  settle();
}

std::string HttpConnection::head_of(HttpStatus status, HttpHeaders headers) {
  decorate(headers);
  if (!can_keep_alive()) headers.emplace_back("Connection", "close");
  const auto reason = http::obsolete_reason(static_cast<http::status>(status));
  std::string text = "HTTP/1.1 " + std::to_string(static_cast<unsigned>(status)) + " ";
  text.append(reason).append("\r\n");
  for (const auto& [name, value] : headers) text.append(name).append(": ").append(value).append("\r\n");
  return text + "\r\n";
}

void HttpConnection::send(std::string_view head, std::string_view body, std::function<void()> then) {
  const std::array<asio::const_buffer, 2> bytes{asio::buffer(head), asio::buffer(body)};
  is_writing_ = true;
  asio::async_write(transport_, bytes, [self = shared_from_this(), then = std::move(then)](ErrorOf error, std::size_t) {
    self->is_writing_ = false;
    if (error) return self->close();
    then();
  });
}

void HttpConnection::read_body(std::span<std::uint8_t> into, std::function<void(ErrorOf, std::size_t)> then) {
  wire_->buffer.max_size(std::max(kMaxReadBytes, wire_->buffer.size()));
  auto& body = wire_->parser->get().body();
  body.data = into.data();
  body.size = into.size();
  http::async_read(*wire_, wire_->buffer, *wire_->parser,
                   [self = shared_from_this(), size = into.size(), then = std::move(then)](ErrorOf error, std::size_t) {
                     const std::size_t count = size - self->wire_->parser->get().body().size;
                     then(error == http::error::need_buffer ? ErrorOf() : error, count);
                   });
}

void HttpConnection::do_on(DiskThreads& threads, std::function<void()> work, std::function<void()> then) {
  threads.post(holder(), [self = shared_from_this(), guard = asio::make_work_guard(context_.loop),
                          work = std::move(work), then = std::move(then)]() mutable {
    work();
    work = nullptr;
    asio::io_context& loop = self->context_.loop;
    // The connection must not be destroyed on the disk's thread.
    asio::post(loop, [self = std::move(self), then = std::move(then)] { then(); });
  });
}

void HttpConnection::finish(bool keep) {
  answers_ = false;
  settle_us_ = 0;
  settle();
  if (keep) return read_head();
  // Half-close, then drain for a while: closing with unread bytes sends a reset, which would discard the answer.
  transport_.end_writing();
  arm(output_ ? limits().transfer_ms : std::min(limits().transfer_ms, kMaxDrainMs));
  drain(transport_);
}

template <typename Stream>
void HttpConnection::drain(Stream& stream) {
  const auto into = asio::buffer(context_.read_buffer);  // Of all: what comes is not looked at.
  stream.async_read_some(into, [self = shared_from_this(), &stream](ErrorOf error, std::size_t) {
    const auto go_on = [self, &stream](ErrorOf) {
      self->transport_.socket().is_open() ? self->drain(stream) : self->close();
    };
    if (error) return error == asio::error::eof ? self->end() : self->close();
    if (Timer* const pace = self->pace()) return pace->async_wait(go_on);
    go_on({});
  });
}

}  // namespace eigencast::broker
