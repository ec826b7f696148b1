// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <boost/asio/buffer.hpp>
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
#include "broker/context/context.h"
#include "broker/sockets/loop_share.h"
#include "broker/sockets/transport.h"

namespace eigencast::broker {

enum class HttpStatus : std::uint16_t {
  kOk = 200,
  kCreated = 201,
  kNoContent = 204,
  kPartialContent = 206,
  kNotModified = 304,
  kBadRequest = 400,
  kForbidden = 403,
  kNotFound = 404,
  kMethodNotAllowed = 405,
  kNotAcceptable = 406,
  kRequestTimeout = 408,
  kConflict = 409,
  kPayloadTooLarge = 413,
  kRangeNotSatisfiable = 416,
  kUnprocessableEntity = 422,
  kUpgradeRequired = 426,
  kHeaderFieldsTooLarge = 431,
  kInternalServerError = 500,
  kNotImplemented = 501,
  kServiceUnavailable = 503,
  kInsufficientStorage = 507,
};

using HttpHeaders = std::vector<std::pair<std::string_view, std::string>>;

/// The peer's address; all zeros once it is gone.
IpAddress peer_of(const Socket& socket);

/// How long to wait before the kernel is asked once more what a peer has acknowledged; 0: it was not asked before. What
/// the peer has is held twice as long as it took at most, and a connection that stays silent costs next to nothing.
constexpr TimeUs next_settle_us(TimeUs last_us) {
  constexpr TimeUs kFirstUs = 100'000, kMostUs = 2'000'000;
  return last_us == 0 ? kFirstUs : std::min(2 * last_us, kMostUs);
}

/// One HTTP/1.1 connection: TLS handshake, request heads one after the other, answers, and a close that loses no
/// answer. Kept alive by its pending operations. Belongs to the first event loop.
/// Only its .cpp includes Boost.Beast, which takes long to compile.
class HttpConnection : public std::enable_shared_from_this<HttpConnection> {
 public:
  virtual ~HttpConnection();
  void start();

  Context& context() { return context_; }
  Transport& transport() { return transport_; }
  const IpAddress& peer() const { return peer_; }

  // The current request.

  std::string_view method() const;
  bool reads() const { return method() == "GET" || method() == "HEAD"; }
  std::string_view target() const;
  std::string header(std::string_view name) const;          ///< The first field of that name, or empty.
  std::string joined_headers(std::string_view name) const;  ///< All fields in order, with commas.
  std::optional<std::uint64_t> content_length() const;
  /// What the request says about its sender. `query_token` is the access_token of its target.
  AccessRequest access_request(std::string query_token) const;
  /// Whether it asks for a WebSocket (RFC 6455, 4.2.1) and waits for the answer before it sends more.
  bool is_websocket_upgrade() const;
  bool is_head_read() const;
  bool has_body() const;
  bool is_body_read() const;
  /// Whether the peer has not taken the answers before yet.
  bool has_unread_answer() { return output_ && transport_.unacknowledged() > 0; }
  std::size_t head_bytes() const;
  std::uint64_t body_chunks() const;  ///< That began so far.
  /// Whether the length of its body is unknown: it names a transfer coding other than chunked.
  bool has_unknown_coding() const;
  /// Whether another request may follow: unread body bytes would be taken for it.
  bool can_keep_alive() const;

  /// Sends a whole answer, then reads the next request or closes. The body is JSON unless `headers` say otherwise.
  void answer(HttpStatus status, std::string body, HttpHeaders headers = {});
  /// The same for bytes that `owner` keeps; null: they stay.
  void answer_with(HttpStatus status, std::string_view body, std::shared_ptr<const void> owner, HttpHeaders headers);
  /// The same for a body of `size` bytes from `source`, which takes `memory`.
  /// Source: calls `then` with the next bytes, at most kPieceBytes, which stay until it is called again; or closes.
  using Source = std::function<void(std::function<void(std::string_view)> then)>;
  static constexpr std::size_t kPieceBytes = 64 * 1024;
  void answer_from(HttpStatus status, std::uint64_t size, std::size_t memory, Source source, HttpHeaders headers);
  void answer_error(HttpStatus status, const Error& error, HttpHeaders headers = {});
  void answer_denial(const Denial& denial);
  /// 429: a limit is reached.
  void answer_limit(const std::string& why, int retry_after_s = 1) { answer_denial({429, why, retry_after_s}); }
  void refuse_method(const char* why, const char* allowed);

  // For bodies that are read piece by piece.

  /// Sends what the caller keeps, then calls `then`. Closes the connection on failure.
  void send(std::string_view head, std::string_view body, std::function<void()> then);
  /// Reads the body's next bytes until `into` is full or the body has ended, then calls `then` with their number.
  /// REQUIRES: !is_body_read().
  void read_body(std::span<std::uint8_t> into, std::function<void(ErrorOf, std::size_t)> then);
  static bool is_body_limit(ErrorOf error);
  /// Closes the connection after `timeout_ms` unless called again, or the peer takes what was sent.
  void arm(std::int64_t timeout_ms);
  void disarm() { timer_.cancel(); }
  /// Calls `then` after `wait_us`, until when nothing times out; at once if that is 0.
  void later(TimeUs wait_us, std::function<void()> then);
  /// For who sends much: as wide as its holder has memory for.
  void widen_receive_buffer();
  /// Ends an answer: reads the next request if `keep`, else closes.
  void finish(bool keep);
  /// At once, whatever the peer has not taken yet.
  void close();
  /// Runs `work`, which returns a Result, on the disk's threads in its holder's turns, then `then` with it on the loop:
  /// no file access delays a frame. Objects that must not end on the disk's threads belong into `then`. Both are
  /// copyable.
  template <typename Work, typename Then>
  void on(DiskThreads& threads, Work work, Then then) {
    const auto outcome = std::make_shared<std::optional<decltype(work())>>();
    do_on(
        threads, [outcome, work = std::move(work)]() mutable { outcome->emplace(guarded(work)); },
        [outcome, then = std::move(then)]() mutable { then(**outcome); });
  }

 protected:
  struct Limits {
    std::int64_t head_ms = 0;      ///< Until the head is complete.
    std::int64_t transfer_ms = 0;  ///< Until an answer is sent.
    std::uint64_t body_bytes = 0;
    const char* body_limit = "";  ///< The setting's name, for messages.
    bool keeps = true;            ///< Whether a connection serves several requests.
  };

  HttpConnection(Context& context, Transport transport);
  virtual Limits limits() const = 0;  ///< Those that the current request has.
  virtual void on_head() = 0;
  /// Takes what a handshake or a read costs from its holder's budget; how long it must wait. Nothing: longer than
  /// most_us, and it was not taken.
  virtual std::optional<TimeUs> take_work(double /*us*/, TimeUs /*most_us*/) { return 0; }
  virtual std::string holder() const { return {}; }  ///< Whose turns it takes.
  /// As LoopShare::take().
  virtual bool take_turn(double, TimeUs, std::function<void()>, LoopShare::Hold = {}) { return true; }
  virtual void decorate(HttpHeaders& headers) const = 0;  ///< Adds what every answer carries.
  /// As Grant::hold_bytes().
  virtual Result<std::shared_ptr<void>> hold_bytes(std::size_t, double = 1) const { return std::shared_ptr<void>(); }
  virtual std::shared_ptr<void> hold_wide(std::size_t) const { return nullptr; }  ///< Null: none is left.
  /// Takes what sending costs from its holder's budget; how long it must wait.
  virtual TimeUs take_sending(double /*us*/) { return 0; }
  const Context& context() const { return context_; }

 private:
  struct Wire;
  struct Outgoing;

  /// An exception on the disk's threads would end the broker.
  template <typename Work>
  static auto guarded(Work& work) -> decltype(work()) {
    try {
      return work();
    } catch (const std::exception& exception) {
      return fail(ErrorCode::kIo, std::string("the disk's thread failed: ") + exception.what());
    }
  }

  std::string head_of(HttpStatus status, HttpHeaders headers);
  /// Whether its holder may have so much memory, and of the kernel's what it holds of an answer, until the peer has
  /// taken that; else it is refused.
  bool begin_output(std::uint64_t size, std::size_t memory);
  void widen();
  void send_rest(const std::shared_ptr<Outgoing>& out);
  void send_in_turn(std::string_view head, std::string_view body, std::function<void()> then);
  /// Frees what counts an answer, and closes where that was the end, once the peer has all; else asks later, at the
  /// expense of its holder.
  void settle();
  /// Closes once the peer has taken all, as it sends nothing more.
  void end();
  bool names_one_host() const;
  void do_on(DiskThreads& threads, std::function<void()> work, std::function<void()> then);
  void read_head();
  void read_more_head();
  LoopShare::Supply hold_handshake();
  void begin_handshake();
  void shake_hands();
  /// After a read, and before what takes `more_us`: what to wait for, whatever its error says, or null.
  Timer* pace(double more_us = 0);
  void on_head_read(ErrorOf error);
  template <typename Stream>
  void drain(Stream& stream);

  Context& context_;
  Transport transport_;
  Timer timer_;
  std::unique_ptr<Timer> pace_;
  std::unique_ptr<Wire> wire_;
  std::shared_ptr<void> unfinished_;  ///< Counts its memory.
  std::shared_ptr<void> output_;      ///< Counts that of an answer, here and in the kernel, until the peer has it;
  std::shared_ptr<void> wide_;        ///< and that of a larger send buffer.
  std::unique_ptr<Timer> settling_;
  TimeUs settle_us_ = 0;  ///< The last wait of it.
  bool is_long_ = false;  ///< The answer may fill the send buffer, and wide_ is not held yet.
  bool answers_ = false;
  bool is_writing_ = false;
  bool ends_ = false;  ///< The peer sends nothing more.
  IpAddress peer_;
};

}  // namespace eigencast::broker
