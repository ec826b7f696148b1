// SPDX-License-Identifier: MIT
#pragma once

#include <openssl/types.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/async_result.hpp>
#include <boost/asio/buffer.hpp>
#include <boost/asio/compose.hpp>
#include <boost/asio/error.hpp>
#include <boost/asio/post.hpp>
#include <cerrno>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>

#include "broker/sockets/net.h"
#include "common/core/bytes.h"

namespace eigencast::broker {

/// Flags of every send of WebSocket bytes. Without MSG_EOR the kernel appends to its last unsent buffer, up to half a
/// window, regardless of TCP_NOTSENT_LOWAT; a stalled viewer would receive all of that backlog.
inline constexpr int kSendFlags = MSG_DONTWAIT | MSG_NOSIGNAL | MSG_EOR;

/// The bytes of one connection, plain or TLS: non-blocking calls for WebSockets, and an asynchronous stream over them
/// for Beast (HTTP). TLS uses OpenSSL directly on the socket and holds no buffers while idle. SIGPIPE must be ignored
/// by the process. Belongs to its event loop.
class Transport {
 public:
  enum class Wait : std::uint8_t { kNo, kReadable, kWritable };
  /// The result of a call: bytes moved, a reason to wait, or an error (asio::error::eof: the peer has closed).
  struct Outcome {
    std::size_t bytes = 0;
    Wait wait = Wait::kNo;
    ErrorOf error{};
  };
  /// Reads a system call's `result`, its bytes or its negated errno. `wait`: for what, if it would block.
  static Outcome outcome_of(std::int64_t result, Wait wait);
  using executor_type = Executor;

  explicit Transport(Socket socket) : socket_(std::move(socket)) {}
  /// Takes `other` off its loop, on whose thread it is called. REQUIRES: no pending operation.
  Transport(asio::io_context& loop, Transport other);
  /// A TLS server; call shake_hands() first, which reports errors.
  Transport(Socket socket, std::shared_ptr<SSL_CTX> context);

  executor_type get_executor() { return socket_.get_executor(); }
  Socket& socket() { return socket_; }
  bool is_tls() const { return tls_ != nullptr; }
  SSL* tls() { return tls_.get(); }

  /// Continues the TLS handshake; done when the outcome does not wait. Plain: done.
  Outcome shake_hands();
  double handshake_us() const;         ///< What a handshake takes, by the kind and size of the certificate's key.
  bool asks_for_certificates() const;  ///< Of clients.
  Outcome read(std::span<std::uint8_t> into);
  /// The peer's TLS records, with data or not, that were worked off since the last call.
  std::size_t take_records();
  /// Whether TLS holds decrypted bytes that were read off the socket with an earlier record.
  bool has_read_ahead() const;
  /// Plain: the bytes sent, or a negated errno.
  std::int64_t send(ByteView bytes) {
    // Not ::send: it is a cancellation point and doubles the cost in a multi-threaded process.
    const long count =
        ::syscall(SYS_sendto, socket_.native_handle(), bytes.data(), bytes.size(), kSendFlags, nullptr, 0);
    return count < 0 ? -errno : count;
  }
  /// TLS: at most one record; the next call must begin with the same held_bytes() bytes.
  Outcome write(std::span<const iovec> pieces);
  /// Leading bytes of the last write() that TLS has encrypted but not sent.
  std::size_t held_bytes() const { return held_; }
  void end_writing();
  void close();
  /// Closes so that the kernel keeps nothing of what the peer has not taken.
  void reset();

  // What the kernel holds.

  std::size_t unacknowledged();       ///< Bytes that the peer has not acknowledged.
  void limit_unsent(int bytes);       ///< Beyond what is on its way (TCP_NOTSENT_LOWAT). 0: as the system says.
  void limit_send_buffer(int bytes);  ///< In all (SO_SNDBUF): twice that, and a segment. 0: the kernel's choice.
  std::size_t unread();               ///< Bytes that have come and wait to be read.
  /// From kReceiveBytes, for who may send much: with a round trip of 100 ms some 10 MB a second, where `held` counts
  /// kWideBytes, which stay for the connection; null: to kSocketBytes.
  void widen_receive_buffer(std::shared_ptr<void> held);
  bool is_wide() const { return wide_ != nullptr; }

  // Its memory for what comes until it is read, some of it its own: half to nearly all is left for bytes.

  /// Handshakes and requests need no more, and a crowd that is read later must not fill its memory.
  static constexpr int kReceiveBytes = 32 * 1024;
  /// Of a WebSocket: the kernel drops packets that it finds no room for, be their bytes few, and with them what they
  /// acknowledge.
  static constexpr int kSocketBytes = 128 * 1024;
  static constexpr int kWideBytes = 2 * 1024 * 1024;

  template <typename Handler>
  void async_wait(Wait wait, Handler&& handler) {
    const auto what = wait == Wait::kWritable ? Socket::wait_write : Socket::wait_read;
    socket_.async_wait(what, std::forward<Handler>(handler));
  }

  // Beast's stream requirements.
  template <typename Buffers, typename Handler>
  auto async_read_some(const Buffers& buffers, Handler&& handler) {
    const asio::mutable_buffer into = *asio::buffer_sequence_begin(buffers);
    return move_some(
        [this, into] {
          return read({static_cast<std::uint8_t*>(into.data()), into.size()});
        },
        std::forward<Handler>(handler));
  }
  template <typename Buffers, typename Handler>
  auto async_write_some(const Buffers& buffers, Handler&& handler) {
    std::array<iovec, 2> pieces{};  // The first non-empty buffers: callers continue with the rest.
    std::size_t count = 0;
    for (auto it = asio::buffer_sequence_begin(buffers); it != asio::buffer_sequence_end(buffers); ++it) {
      const asio::const_buffer from = *it;
      if (from.size() == 0) continue;
      pieces[count++] = {const_cast<void*>(from.data()), from.size()};
      if (count == pieces.size()) break;
    }
    return move_some(
        [this, pieces, count] {
          return write({pieces.data(), std::max<std::size_t>(count, 1)});
        },
        std::forward<Handler>(handler));
  }

 private:
  /// Retries until `attempt` need not wait; completes on the loop, never within the call.
  template <typename Try, typename Handler>
  auto move_some(Try attempt, Handler&& handler) {
    return asio::async_compose<Handler, void(ErrorOf, std::size_t)>(
        [this, attempt, outcome = Outcome{}, posted = false](auto& self, ErrorOf error = {}) mutable {
          if (!posted) {
            outcome = error ? Outcome{0, Wait::kNo, error} : attempt();
            if (outcome.wait != Wait::kNo) return async_wait(outcome.wait, std::move(self));
            posted = true;
            return asio::post(socket_.get_executor(), std::move(self));
          }
          self.complete(outcome.error, outcome.bytes);
        },
        handler, socket_);
  }

  struct FreeTls {
    void operator()(SSL* tls) const;
  };

  Outcome tls_outcome(int result);
  Outcome write_tls(std::span<const iovec> pieces);

  Socket socket_;
  std::unique_ptr<SSL, FreeTls> tls_;
  std::size_t held_ = 0;
  bool tls_failed_ = false;
  std::shared_ptr<void> wide_;
};

}  // namespace eigencast::broker
