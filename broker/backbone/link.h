// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// What connects brokers: messages by subject, questions with answers, and a table of streams that all share. Handlers
/// of a Link are called on the broker's event loop; nothing here blocks it.
class Link {
 public:
  /// Hears what comes.
  class Listener {
   public:
    virtual ~Listener() = default;
    /// The connection is up (again), or lost.
    virtual void on_connected() = 0;
    virtual void on_disconnected(const std::string& why) = 0;
    /// The table is another one than before (its servers lost it, somebody removed it): what was told of rows is void.
    virtual void on_new_table() = 0;
    /// A row of the table; `text` is empty where it was removed.
    virtual void on_row(const std::string& key, std::optional<std::string> text, std::uint64_t revision) = 0;
    /// All rows that the table had when the connection came up have been told.
    virtual void on_table_read() = 0;
  };

  using Handler = std::function<void(Bytes message)>;
  using Answer = std::function<void(Result<Bytes>)>;
  /// Sends the answer to a question; thread-safe.
  using Reply = std::function<void(Bytes message)>;
  using Questioned = std::function<void(Bytes message, Reply reply)>;

  virtual ~Link() = default;
  /// Connects, and goes on trying. `listener` must outlive it, or what stop() ended.
  virtual void start(Listener& listener) = 0;
  /// No handler is called any more when it returns.
  virtual void stop() = 0;

  /// Dropped where there is no connection, or too much waits already.
  virtual void publish(const std::string& subject, Bytes message) = 0;
  /// Messages of the subject from now on, in the order in which each broker published them. Ends when what is returned
  /// is destroyed.
  virtual std::shared_ptr<void> subscribe(const std::string& subject, Handler handler) = 0;
  /// Questions asked on the subject.
  virtual std::shared_ptr<void> serve(const std::string& subject, Questioned questioned) = 0;
  /// Errors of the answer: kUnreachable (nobody listens there, no connection), kTimeout.
  virtual void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) = 0;

  /// Writes a row of the table if its revision is still `expected` (0: it never was there); empty text removes it.
  /// Gives the new revision. Errors: kRefused (another revision), kUnreachable (the table does not answer just now).
  virtual void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                         std::function<void(const Result<std::uint64_t>&)> written) = 0;
};

}  // namespace eigencast::broker
