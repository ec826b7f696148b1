// SPDX-License-Identifier: MIT
#pragma once

#include <nats/nats.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <thread>

#include "broker/backbone/link.h"
#include "common/core/fair_queue.h"

namespace eigencast::broker {

template <auto destroy>
struct Destroyer {
  template <typename T>
  void operator()(T* object) const {
    destroy(object);
  }
};
using OptionsPtr = std::unique_ptr<natsOptions, Destroyer<natsOptions_Destroy>>;
using MessagePtr = std::unique_ptr<natsMsg, Destroyer<natsMsg_Destroy>>;
using JetStreamPtr = std::unique_ptr<jsCtx, Destroyer<jsCtx_Destroy>>;
using StorePtr = std::unique_ptr<kvStore, Destroyer<kvStore_Destroy>>;
using WatcherPtr = std::unique_ptr<kvWatcher, Destroyer<kvWatcher_Destroy>>;
using StreamInfoPtr = std::unique_ptr<jsStreamInfo, Destroyer<jsStreamInfo_Destroy>>;
using EntryPtr = std::unique_ptr<kvEntry, Destroyer<kvEntry_Destroy>>;

/// Bounds messages on their way to the loop, those of one subscription to a quarter of what is free; more are dropped,
/// as NATS may.
inline constexpr std::size_t kMaxUndeliveredBytes = 32u << 20;

/// Shared by nats_link.cpp (messages) and nats_table.cpp (the table) only.
///
/// libnats calls back from its own threads and may block. So a sender thread publishes from a bounded queue, which
/// drops messages like core NATS, and incoming messages are posted to the event loop.
///
/// libnats waits without end for a server that is mute in a TLS handshake or after INFO, and holds locks that all its
/// calls need, while it reconnects too. So only the reader's thread connects, to one server at a time, and the sender's
/// shuts down the socket of a try that takes long.
class NatsLink final : public Link, public std::enable_shared_from_this<NatsLink> {
 public:
  struct Settings {
    std::string prefix, id;
    int replicas = 1;  ///< How many the table has if this broker creates it: 1, 3 or 5.
    std::vector<std::string> servers;
    std::chrono::steady_clock::duration stop_within{};
  };
  NatsLink(Settings settings, OptionsPtr options, std::function<void(std::function<void()>)> on_loop);

  void start(Listener& listener) override;
  void stop() override;
  using Link::publish;
  void publish(const std::string& subject, Bytes message, const std::string& holder) override {
    send({subject, {}, std::move(message)}, holder);
  }
  std::shared_ptr<void> subscribe(const std::string& subject, Handler handler) override;
  std::shared_ptr<void> serve(const std::string& subject, OnRequest on_request) override;
  void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) override;
  void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                 std::function<void(const Result<std::uint64_t>&)> written) override;
  void publish_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision) override;

 private:
  struct Outgoing {
    std::string subject, reply;
    Bytes message;
  };
  struct Request {
    Answer answer;
    std::chrono::steady_clock::time_point until;
  };
  struct Incoming {
    std::string subject, reply;
    bool unheard = false;  ///< Nobody listens to what it answers.
    Bytes message;
  };
  /// `heard` runs on libnats' thread, possibly after stop() has returned, but not after the link's end.
  struct Subscribed {
    std::weak_ptr<NatsLink> link;
    std::string subject;
    std::function<void(natsMsg*)> heard;
    std::atomic<bool> wanted{true};
    // Belong to the sender.
    std::shared_ptr<natsConnection> connection{};
    std::shared_ptr<natsSubscription> subscription{};  ///< At the connection.
  };

  void send(Outgoing message, const std::string& holder);
  void to_loop(std::function<void()> work);
  void post_to_listener(std::function<void()> work);
  void report_connection();
  void run(std::thread& thread, void (NatsLink::*work)());
  void connect();
  void end_try(std::unique_lock<std::mutex>& lock);
  void on_closed(natsConnection* connection);
  void close();
  std::shared_ptr<void> listen(const std::string& subject, std::function<void(Incoming)> handler);
  std::shared_ptr<void> subscribe_raw(const std::string& subject, std::function<void(natsMsg*)> heard);
  static void renew(const std::shared_ptr<Subscribed>& subscribed, const std::shared_ptr<natsConnection>& connection);
  void send_all();
  void expire_requests();
  void write_all();
  void read_table();
  void watch_once(std::uint64_t generation);
  JetStreamPtr jet_stream();
  Result<StorePtr> open_table(jsCtx& js) const;
  bool report_new_table(jsCtx& js);
  Result<std::uint64_t> write_now(const std::string& key, const std::optional<std::string>& text,
                                  std::uint64_t expected);
  /// On the loop. Lost changes are found when the table is read again.
  void take_row(const std::string& from, ByteView message);

  const Settings settings_;
  const std::string bucket_, inbox_;
  OptionsPtr options_;                            // Belongs to the reader.
  std::vector<std::string> servers_;              // Belongs to the reader: those to try, and those that they named.
  std::size_t tries_ = 0;                         // Belongs to the reader: since the last connection.
  std::chrono::steady_clock::time_point made_{};  // Belongs to the reader: the last connection.
  std::function<void(std::function<void()>)> on_loop_;
  Listener* listener_ = nullptr;                               // Belongs to the loop.
  std::map<std::string, Request> requests_;                    // Belongs to the loop, by token.
  std::shared_ptr<bool> open_ = std::make_shared<bool>(true);  // Belongs to the loop: handlers may be called.
  std::int64_t table_made_ = 0;                                // Belongs to the reader: creation time of the table.
  std::atomic<std::size_t> undelivered_{0};                    ///< Bytes on their way to the loop.
  std::atomic<bool> waiting_{false};                           ///< requests_ is not empty.
  std::vector<std::shared_ptr<void>> subscriptions_;

  std::mutex mutex_;
  std::condition_variable wake_;
  // GUARDED_BY(mutex_), all that follows.
  FairQueue<Outgoing> outgoing_;
  std::deque<std::function<void()>> rows_, removals_;  ///< To be written.
  bool connected_ = false, stopping_ = false;
  ConnectionNews news_;
  bool written_ = false;  ///< The writer has ended.
  int running_ = 0;       ///< Threads of the link.
  std::optional<std::chrono::steady_clock::time_point> try_until_;
  std::uint64_t generation_ = 0;  ///< Number of the connection.
  std::shared_ptr<natsConnection> connection_;
  std::vector<std::shared_ptr<Subscribed>> subscribed_;
  bool subscribed_changed_ = false;
  std::chrono::steady_clock::time_point drain_until_{};

  std::thread sender_, writer_, reader_;
};

}  // namespace eigencast::broker
