// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "broker/backbone/link.h"

namespace eigencast::broker {

/// A Link over NATS: subjects and requests of the core, and a bucket of JetStream's key-value store as the table.
///
/// libnats calls from threads of its own and may block in whatever is asked of it, so everything that leaves goes
/// through a thread (bounded: what finds no room is dropped, as the core of NATS itself would), everything that comes
/// is handed to the event loop.
class NatsLink final : public Link {
 public:
  struct Settings {
    std::vector<std::string> servers;        ///< nats://HOST:PORT, tls://HOST:PORT
    std::string name;                        ///< Of this broker, for the server's own lists.
    std::string prefix = "eigencast";        ///< Names the bucket, and the subject on which rows are told.
    int replicas = 1;                        ///< Of the table, when this broker is the first and makes it: 1, 3 or 5.
    std::string ca_file;                     ///< Who vouches for the servers; empty: the system's.
    std::string certificate_file, key_file;  ///< Of this broker; empty: none.
    std::string credentials_file;            ///< A .creds file; empty: none.
    std::string user, password, token;       ///< Empty: none.
  };

  /// on_loop  runs work on the event loop; thread-safe. Errors: kInvalidArgument, kIo (options that libnats refuses).
  static Result<std::unique_ptr<NatsLink>> create(const Settings& settings,
                                                  std::function<void(std::function<void()>)> on_loop);
  ~NatsLink() override;

  void start(Listener& listener) override;
  void stop() override;
  void publish(const std::string& subject, Bytes message) override;
  std::shared_ptr<void> subscribe(const std::string& subject, Handler handler) override;
  std::shared_ptr<void> serve(const std::string& subject, Questioned questioned) override;
  void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) override;
  void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                 std::function<void(const Result<std::uint64_t>&)> written) override;

 private:
  class Impl;
  explicit NatsLink(std::shared_ptr<Impl> impl);
  std::shared_ptr<Impl> impl_;
};

}  // namespace eigencast::broker
