// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "common/core/bytes.h"
#include "common/core/log.h"
#include "common/net/url.h"

namespace eigencast {

/// What became of a message that was handed to a connection.
enum class [[nodiscard]] SendStatus{
    kSent,          ///< Queued on the socket.
    kDropped,       ///< The link is behind (max_unsent_bytes): send the next one instead.
    kDisconnected,  ///< No connection now; it is being made anew.
};

struct WebSocketOptions {
  BrokerUrl url;       ///< Its brokers are tried in turn.
  std::string target;  ///< Path and query of the upgrade, e.g. "/v1/subscribe/heart?rate=raw".
  /// Resolving, connecting and the upgrade together; for each further address of the host once more.
  std::chrono::milliseconds connect_timeout{3000};
  std::chrono::milliseconds first_retry{200};  ///< Before the first reconnect; doubles, with jitter of +-25 %.
  std::chrono::milliseconds longest_retry{5000};
  std::chrono::milliseconds silence_timeout{10000};  ///< Nothing received, pings included, for so long = dead.
  std::size_t max_unsent_bytes = 256 * 1024;         ///< kDropped above this.
  std::chrono::milliseconds tick{0};                 ///< How often on_tick is called while it is open; 0: never.
};

/// Called on the connection's own thread, one at a time; must return soon and must not destroy the WebSocket.
struct WebSocketEvents {
  /// Before each try to connect: the target of this one. Empty: always that of the options.
  std::function<std::string()> on_try;
  std::function<void()> on_tick;
  /// With the broker, and its address, that was reached.
  std::function<void(const BrokerUrl& broker)> on_open;
  std::function<void(std::string_view)> on_text;
  std::function<void(ByteView)> on_binary;
  /// The broker was lost or not reached; the next try starts in `retry_in` (0: none, stopped or refused for good).
  /// `why` says which of several brokers is next.
  std::function<void(const Error& why, std::chrono::milliseconds retry_in)> on_down;
};

/// A client's WebSocket connection that keeps itself up. It speaks subprotocol eigencast.v2, answers pings, notices a
/// dead peer and reconnects with jittered exponential back-off. After a refusal (HTTP 4xx, or a close code that says
/// so) it waits for the longest interval. It tries again every half a minute after a refusal that only people can put
/// right (no right, expired token, untrusted certificate). TLS and token are those of the URL. TCP_NODELAY is set. An
/// exception that an event's handler throws ends the connection, not the process; it is made anew.
///
/// Each broker of the URL has a back-off of its own: when one is lost the next is tried at once, 0 to 50 ms later, or
/// within the pause of hold_off(). So is the next address of a name that has several, once a connection held for two
/// seconds; addresses that do not answer are passed over without an event.
///
/// Runs one thread. send_* and stop() are safe from any thread; what is sent is written on the caller's where the
/// connection is idle, without ever waiting for the socket.
class WebSocket {
 public:
  /// Events may come before it returns.
  static std::unique_ptr<WebSocket> start(WebSocketOptions options, WebSocketEvents events, LogSink log = {});
  virtual ~WebSocket() = default;  ///< Stops.

  virtual SendStatus send_text(std::string text) = 0;
  virtual SendStatus send_binary(Bytes message) = 0;
  /// Bytes handed to send_* that the socket has not taken yet.
  virtual std::size_t unsent_bytes() const = 0;
  virtual bool is_open() const = 0;
  /// The peer is about to close and asks to be left alone for so long: the least pause before the next try once this
  /// connection is down, at most ten minutes, and 30 s before another broker of the URL. 0: it does not expect us
  /// back; the longest interval then.
  virtual void hold_off(std::chrono::milliseconds pause) = 0;
  /// Ends the pause before the next try, if there is one now.
  virtual void retry_now() = 0;
  /// Closes politely (at most 500 ms) and ends the thread. No event comes afterwards. A name lookup under way cannot be
  /// broken off: stop() then waits for it, as long as the system's resolver takes.
  virtual void stop() = 0;
};

}  // namespace eigencast
