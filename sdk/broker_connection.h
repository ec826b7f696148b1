// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/net/clock_offset.h"
#include "common/net/url.h"
#include "common/net/websocket.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/broker.h"

namespace eigencast {

/// One connection to a broker, the one of the URL's that is there (one socket, one thread), shared by all streams that
/// are watched there with the same credentials. It reconnects by itself and then subscribes to all again, and asks
/// again for streams that the broker declined. A connection of one stream names it in its URL, which saves a round
/// trip; one of several never does, so that a refused stream does not refuse the others. A second subscriber to a
/// stream gets another connection. Thread-safe.
class BrokerConnection final {
 public:
  /// Called on the connection's thread, one call at a time; on_open() and on_down() also within join(). No call may
  /// lead to join() or leave().
  class Listener {
   public:
    virtual ~Listener() = default;
    virtual void on_open(const BrokerUrl& broker) = 0;
    /// wait  until the next try; 0: none
    virtual void on_down(const Error& why, std::chrono::milliseconds wait) = 0;
    virtual void on_info(const control::StreamInfo& info) = 0;
    virtual void on_memory(const control::Remember& memory) = 0;
    virtual void on_trace(const control::Trace& trace) = 0;
    virtual void on_notice(const control::Notice& notice) = 0;
    /// declined  The broker does not give this stream; it is asked again after declined_retry.
    virtual void on_error(const control::ErrorMessage& error, bool declined) = 0;
    /// This connection has as many streams as the broker allows: leave it and join another.
    virtual void on_crowded_out() = 0;
    virtual void on_clock(const ClockOffset::Estimate& clock) = 0;
    virtual void on_moment(const control::Moment& moment) = 0;
    virtual void on_history(const control::History& history) = 0;
    /// Nothing in it: it could not be read, or belongs to another chain.
    virtual void on_frame(const std::optional<FrameView>& frame, std::size_t bytes, TimeUs now) = 0;
  };

  /// One's place in a room: as Listener. on_room_down() may be called within enter().
  class RoomListener {
   public:
    virtual ~RoomListener() = default;
    virtual ControlMessage on_room_open() = 0;  ///< Enter, to be sent.
    virtual void on_room_down(const Error& why) = 0;
    virtual void on_room(const control::Room& news) = 0;
    virtual void on_room_error(const control::ErrorMessage& error) = 0;
    virtual std::vector<ControlMessage> on_room_tick(TimeUs now) = 0;  ///< To be sent.
  };

  struct Request {
    control::Subscribe subscribe;
    std::uint32_t trace_every = 0;
    std::chrono::milliseconds declined_retry{5000};
    LogSink log;
  };

  static std::shared_ptr<BrokerConnection> join(const BrokerUrl& url, Request request, Listener& listener);
  static std::shared_ptr<BrokerConnection> enter(const BrokerUrl& url, const std::string& room, RoomListener& listener);
  /// Lost where the connection is.
  void send_in_room(const ControlMessage& message);
  /// No call comes afterwards.
  void leave(const RoomListener& listener, const std::string& room);
  /// Names the generation of a memory to the broker once: what comes afterwards may need it. 0: none.
  void hold(const Listener& listener, std::uint32_t generation);
  /// What concerns the listener's stream; lost where the broker does not give it now.
  void say(const Listener& listener, const ControlMessage& message);
  /// No call comes afterwards. The last user to release the connection closes it.
  void leave(const Listener& listener);

  explicit BrokerConnection(const BrokerUrl& url);
  ~BrokerConnection();  ///< At most 500 ms, as WebSocket::stop().
  BrokerConnection(const BrokerConnection&) = delete;
  BrokerConnection& operator=(const BrokerConnection&) = delete;

 private:
  struct Stream {
    Request request;
    Listener* listener;
    std::optional<std::uint32_t> id;        ///< Once the broker has said it on this connection.
    EnvelopeReader reader;                  ///< Of its frames.
    std::optional<control::Ack::Item> ack;  ///< Newest frame that is not acknowledged yet.
    std::uint32_t generation = 0;           ///< Of the memory to be named with it.
    std::optional<TimeUs> ask_again_at_us;  ///< Set while the broker declines the stream.

    const std::string& name() const { return request.subscribe.stream; }
  };

  bool try_join(Request& request, Listener& listener);
  bool try_enter(const std::string& room, RoomListener& listener);
  void start();
  std::string next_target();
  void on_open(const BrokerUrl& broker);
  void on_down(const Error& why, std::chrono::milliseconds wait);
  void on_text(std::string_view text);
  void on_binary(ByteView bytes);
  template <typename Message>
  void on_message(const Message&) {}  // What concerns senders only.
  void on_message(const control::StreamInfo& m);
  void on_message(const control::Remember& m);
  void on_message(const control::Trace& m);
  void on_message(const control::Ping& m);
  void on_message(const control::Pong& m);
  void on_message(const control::Notice& m);
  void on_message(const control::ErrorMessage& m);
  void on_message(const control::Bye& m);
  void on_message(const control::Room& m);
  void on_message(const control::Moment& m);
  void on_message(const control::History& m);
  void on_tick();  ///< Acknowledges what a burst left over, asks again for declined streams, and pings.
  void acknowledge(TimeUs now);
  void subscribe(Stream& stream);
  /// One that is lost is made up for: the connection is made anew.
  void send(const ControlMessage& message) { (void)socket_->send_text(text_from_control(message)); }
  Stream* find(std::string_view name);
  template <typename Call>
  void for_each(std::string_view name_or_all, Call call);
  void log(LogLevel level, std::string_view text) const;

  const BrokerUrl url_;
  /// Held in all calls of listeners and log sinks, so that leave() waits for them; recursive for sinks within a send.
  mutable std::recursive_mutex mutex_;
  // GUARDED_BY(mutex_), all that follows.
  std::list<Stream> streams_;  ///< Oldest first.
  std::map<std::string, RoomListener*> rooms_;
  std::string url_stream_;  ///< Whom the present connection's URL names; empty: nobody.
  bool open_ = false;
  BrokerUrl at_;          ///< The broker that it is or was connected to.
  bool crowded_ = false;  ///< The broker allows no more streams.
  std::optional<std::pair<Error, std::chrono::milliseconds>> down_;
  RetryLog retries_;
  ClockOffset clock_;
  TimeUs last_ack_us_ = 0, last_ping_us_ = 0;
  std::uint64_t ping_id_ = 0;
  std::unique_ptr<WebSocket> socket_;
};

}  // namespace eigencast
