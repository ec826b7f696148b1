// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "common/codec/key.h"
#include "common/core/clock.h"
#include "common/core/histogram.h"
#include "common/core/log.h"
#include "common/net/clock_offset.h"
#include "common/net/url.h"
#include "common/net/websocket.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/frame_decoder.h"

namespace eigencast {

/// A decoded pose on its way to the caller: absent bands are filled in there, where the asset is.
struct Arrival {
  Envelope envelope;
  TimeUs arrival_us = 0;
  TimeUs decoded_us = 0;
  Key key;
  CoefficientLayout layout;
};

/// The network's side of a Subscriber: connection, control messages, chain, acknowledgements. Connects from its making
/// to its end; what it finds waits for take() and condition(), which any thread may call.
class Receiver {
 public:
  struct News {
    std::deque<Arrival> poses;                ///< At most 64, newest kept.
    std::optional<control::StreamInfo> info;  ///< Set when it changed since the last take.
    bool declined = false;                    ///< The subscription was refused since then; no info came after it.
  };
  struct Condition {
    bool open = false, ever_open = false, refused = false;
    bool declined = false;  ///< Connected, but the broker does not give us the stream; it is asked again.
    std::string trouble;    ///< Of the connection; empty while all is well.
    std::string notice;     ///< What the broker said last.
    FrameDecoder::Counts counts;
    std::uint64_t bytes = 0;
    std::uint64_t reconnects = 0;
    std::uint64_t skipped = 0;
    std::optional<ClockOffset::Estimate> clock;
    Histogram latency_us;
  };

  /// wake  is called, on threads of the receiver's own, when there is something new
  Receiver(BrokerUrl url, Profile profile, std::uint32_t trace_every, std::chrono::milliseconds declined_retry,
           std::function<void()> wake, LogSink log);
  ~Receiver();

  News take();
  /// At most 256, oldest first: older ones are dropped.
  std::vector<control::Trace> take_traces();
  Condition condition() const;

 private:
  void on_open();
  void on_down(const Error& why, std::chrono::milliseconds wait);
  void on_text(std::string_view text);
  template <typename Message>
  void on_message(const Message&) {}  // What concerns senders only.
  void on_message(const control::StreamInfo& m);
  void on_message(const control::Trace& m);
  void on_message(const control::Ping& m);
  void on_message(const control::Pong& m);
  void on_message(const control::Notice& m);
  void on_message(const control::ErrorMessage& m);
  void on_message(const control::Bye& m);
  void on_binary(ByteView bytes);
  /// Decodes a message that came at `now` and keeps its pose, if it shows one. Errors: for the log. REQUIRES: mutex_ is
  /// held.
  Result<bool> take_frame(ByteView bytes, TimeUs now);
  /// REQUIRES: mutex_ is held and ack_ is set.
  void acknowledge(TimeUs now);
  void send(std::string text);
  /// Acknowledges what the last frame of a burst left over, asks again where it was declined, and pings.
  void tick();

  const BrokerUrl url_;
  const Profile profile_;
  const std::uint32_t trace_every_;
  const std::chrono::milliseconds declined_retry_;
  const std::function<void()> wake_;
  const LogSink log_;

  mutable std::mutex mutex_;
  std::condition_variable stop_;
  // GUARDED_BY(mutex_), all that follows.
  bool stopping_ = false;
  FrameDecoder decoder_;
  ClockOffset clock_;
  bool trace_asked_ = false;           ///< On this connection.
  std::deque<control::Trace> traces_;  ///< Bounded, newest kept.
  News news_;
  Condition condition_;
  TimeUs notice_until_us_ = 0;
  std::uint64_t unparsed_ = 0;
  std::optional<control::Ack::Item> ack_;  ///< Newest frame that is not acknowledged yet.
  TimeUs last_ack_us_ = 0, last_ping_us_ = 0;
  std::uint64_t ping_id_ = 0;
  std::optional<TimeUs> ask_again_at_us_;
  std::unique_ptr<WebSocket> socket_;

  std::thread ticker_;
};

}  // namespace eigencast
