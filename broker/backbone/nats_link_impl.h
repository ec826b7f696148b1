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

#include "broker/backbone/nats_link.h"

namespace eigencast::broker {

// What libnats gives away, with its end.
template <auto destroy>
struct Destroyer {
  template <typename T>
  void operator()(T* object) const {
    destroy(object);
  }
};
using OptionsPtr = std::unique_ptr<natsOptions, Destroyer<natsOptions_Destroy>>;
using ConnectionPtr = std::unique_ptr<natsConnection, Destroyer<natsConnection_Destroy>>;
using MessagePtr = std::unique_ptr<natsMsg, Destroyer<natsMsg_Destroy>>;
using JetStreamPtr = std::unique_ptr<jsCtx, Destroyer<jsCtx_Destroy>>;
using StorePtr = std::unique_ptr<kvStore, Destroyer<kvStore_Destroy>>;
using WatcherPtr = std::unique_ptr<kvWatcher, Destroyer<kvWatcher_Destroy>>;
using StreamInfoPtr = std::unique_ptr<jsStreamInfo, Destroyer<jsStreamInfo_Destroy>>;
using EntryPtr = std::unique_ptr<kvEntry, Destroyer<kvEntry_Destroy>>;

/// What nats_link.cpp (messages) and nats_table.cpp (the table) share, and nobody else sees.
class NatsLink::Impl : public std::enable_shared_from_this<Impl> {
 public:
  Impl(Settings settings, OptionsPtr options, std::function<void(std::function<void()>)> on_loop);
  ~Impl() { stop(); }

  void start(Listener& listener);
  void stop();
  void publish(const std::string& subject, Bytes message, const std::string& reply = {});
  std::shared_ptr<void> subscribe(const std::string& subject, std::function<void(Bytes, std::string reply)> handler);
  void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer);
  void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                 std::function<void(const Result<std::uint64_t>&)> written);

 private:
  struct Outgoing {
    std::string subject, reply;
    Bytes message;
  };
  struct Question {
    Answer answer;
    std::chrono::steady_clock::time_point until;
  };
  /// What libnats holds of a subscription. `heard` runs on its thread, and may do so yet when stop() has returned.
  struct Subscribed {
    std::shared_ptr<Impl> impl;
    std::function<void(natsMsg*)> heard;
  };

  void to_loop(std::function<void()> work);
  void hand_over(std::function<void()> work);
  void listen_to_connection();
  void came_up();
  void went_down(const std::string& why);
  std::shared_ptr<void> subscribe_raw(const std::string& subject, std::function<void(natsMsg*)> heard);
  void send_all();
  void expire_questions();
  void write_all();
  void read_table();
  void watch_once(std::uint64_t generation);
  JetStreamPtr jet_stream() const;
  Result<StorePtr> open_table(jsCtx& js) const;
  bool tell_new_table(jsCtx& js);
  Result<std::uint64_t> write_now(const std::string& key, const std::optional<std::string>& text,
                                  std::uint64_t expected);
  void tell_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision);
  void hear_row(ByteView message);  // On the loop. What is lost is found when the table is read again.

  const Settings settings_;
  const std::string bucket_, inbox_;
  OptionsPtr options_;
  ConnectionPtr connection_;
  std::function<void(std::function<void()>)> on_loop_;
  Listener* listener_ = nullptr;                               // Of the loop.
  std::map<std::uint64_t, Question> questions_;                // Of the loop.
  std::uint64_t last_question_ = 0;                            // Of the loop.
  std::shared_ptr<bool> open_ = std::make_shared<bool>(true);  // Of the loop: handlers may be called.
  std::int64_t table_made_ = 0;                                // Of the reader: when the table was, by its servers.
  std::atomic<int> coming_{0};
  std::atomic<bool> waiting_{false};  ///< There are questions.
  std::vector<std::shared_ptr<void>> subscriptions_;

  std::mutex mutex_;
  std::condition_variable news_;
  // GUARDED_BY(mutex_), all that follows.
  std::deque<Outgoing> outgoing_;
  std::size_t outgoing_bytes_ = 0;
  std::deque<std::function<void()>> rows_;
  bool connected_ = false, stopping_ = false;
  std::uint64_t generation_ = 0;  ///< Of the connection.
  std::chrono::steady_clock::time_point leave_until_{};

  std::thread sender_, writer_, reader_;
};

}  // namespace eigencast::broker
