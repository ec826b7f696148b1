// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Connects brokers: messages by subject, requests with replies, and a shared table of streams. Calls handlers on the
/// broker's event loop and never blocks it.
class Link {
 public:
  class Listener {
   public:
    virtual ~Listener() = default;
    /// Again or for the first time.
    virtual void on_connected() = 0;
    virtual void on_disconnected(const std::string& why) = 0;
    /// The table was replaced (lost or removed): earlier rows are void.
    virtual void on_new_table() = 0;
    /// No `text`: a removal. `from`: the broker that says so, by the subject of its message; empty: the table.
    virtual void on_row(const std::string& key, std::optional<std::string> text, std::uint64_t revision,
                        const std::string& from) = 0;
    /// on_row() has been called for all rows that the table had at connection.
    virtual void on_table_read() = 0;
  };

  using Handler = std::function<void(const std::string& subject, Bytes message)>;
  using Answer = std::function<void(Result<Bytes>)>;
  /// Sends the answer to a request; thread-safe.
  using Reply = std::function<void(Bytes message)>;
  using OnRequest = std::function<void(Bytes message, Reply reply)>;

  virtual ~Link() = default;
  /// Connects, with retries, and does not wait for it. `listener` outlives stop().
  virtual void start(Listener& listener) = 0;
  /// Sends what waits, for a second or timeouts.shutdown_ms at most. No handler is called after it returns.
  virtual void stop() = 0;

  /// Drops the message without a connection, or if its holder's share of those that wait is used up. Messages of one
  /// holder keep their order.
  virtual void publish(const std::string& subject, Bytes message, const std::string& holder) = 0;
  /// The same for this broker's own.
  void publish(const std::string& subject, Bytes message) { publish(subject, std::move(message), {}); }
  /// Messages of the subject (PREFIX.>: of all below it) from now on, in each holder's order. Destroying the result
  /// ends the subscription.
  virtual std::shared_ptr<void> subscribe(const std::string& subject, Handler handler) = 0;
  /// Answers requests on the subject; lifetime as subscribe().
  virtual std::shared_ptr<void> serve(const std::string& subject, OnRequest on_request) = 0;
  /// Errors of the answer: kUnreachable (no listener, no connection), kTimeout.
  virtual void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) = 0;

  /// Writes a row of the table if its revision is `expected` (0: never written); empty text removes it. Returns the new
  /// revision. Errors: kRefused (another revision), kUnreachable (the table does not answer).
  virtual void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                         std::function<void(const Result<std::uint64_t>&)> written) = 0;
  /// Tells the other brokers of a row of the table as this broker knows it, whether or not the table answers.
  virtual void publish_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision) = 0;
};

/// What a link's listener has yet to hear of its connection: a loss, then a new connection. Noted with each change, so
/// that its order does not depend on which thread reports first.
struct ConnectionNews {
  std::optional<std::string> lost;  ///< Why, the last time.
  bool connected = false;

  void note_connected() { connected = true; }
  void note_lost(std::string why) { *this = {std::move(why), false}; }
  void report(Link::Listener& listener) const {
    if (lost) listener.on_disconnected(*lost);
    if (connected) listener.on_connected();
  }
};

}  // namespace eigencast::broker
