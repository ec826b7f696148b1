// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "common/codec/key.h"
#include "common/core/clock.h"
#include "common/core/histogram.h"
#include "common/net/clock_offset.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/broker_connection.h"
#include "sdk/frame_decoder.h"
#include "sdk/subscriber.h"

namespace eigencast {

/// One stream of a broker's connection, from its making to its end, and what came of it. Any thread may call these.
class Receiver final : private BrokerConnection::Listener {
 public:
  struct News {
    std::optional<BrokerUrl> broker;          ///< Set when one was reached since the last take.
    std::deque<ReceivedPose> poses;           ///< At most 64, newest kept; absent bands are zero yet.
    std::optional<control::StreamInfo> info;  ///< Set when it changed since the last take.
    std::optional<control::Remember> memory;  ///< Likewise, with all of its segments; that of the latest info.
    bool declined = false;                    ///< The subscription was refused since then; no info came after it.
  };
  struct Condition {
    bool open = false, ever_open = false, refused = false;
    bool declined = false;  ///< Connected, but the broker does not give us the stream; it is asked again.
    std::string trouble;    ///< Says why there is no connection; empty while all is well.
    std::string notice;     ///< What the broker said last.
    FrameDecoder::Counts counts;
    std::uint64_t frames = 0, bytes = 0;
    std::uint64_t recalled = 0;
    std::uint64_t reconnects = 0;
    std::optional<TimeUs> retry_at_us;  ///< Of the next try, on the steady clock.
    std::uint64_t dropped = 0;
    std::optional<ClockOffset::Estimate> clock;
    Histogram latency_us;
  };

  /// wake  is called on the connection's thread
  Receiver(const BrokerUrl& url, BrokerConnection::Request request, std::function<void()> wake);
  ~Receiver() override { connection_->leave(*this); }

  /// Use from one thread. Where a broker may be behind a path it is asked first: see located().
  News take();
  /// Keys may be predicted from these poses from now on, unless a memory that begins otherwise was announced meanwhile.
  void hold(const control::Remember& memory, const PoseMemory& poses);
  void say_prepared(const std::string& asset) { say(control::Prepared{name(), asset}); }
  // See Rewind.
  std::optional<Rewind::Kept> kept() const;
  void ask_kept() { say(control::History{name()}); }
  void seek(TimeUs at_us, double speed, bool next) { say(control::Seek{name(), at_us, next, speed}); }
  void show_present() { say(request_.subscribe); }
  /// At t on our clock the pose of t minus this is to be shown; nothing: that is not known (yet).
  std::optional<SharedMoment> moment() const;
  /// On our clock, see control::Late; passed on four times a second at most.
  void report_late(TimeUs needed_lag_us);
  std::vector<control::Trace> take_traces();  ///< At most 256, oldest first.
  Condition condition() const;

 private:
  void on_open(const BrokerUrl& broker) override;
  void on_down(const Error& why, std::chrono::milliseconds wait) override;
  void on_info(const control::StreamInfo& info) override;
  void on_memory(const control::Remember& memory) override;
  void on_trace(const control::Trace& trace) override;
  void on_notice(const control::Notice& notice) override;
  void on_error(const control::ErrorMessage& error, bool declined) override;
  void on_crowded_out() override;
  void on_clock(const ClockOffset::Estimate& clock) override;
  void on_moment(const control::Moment& moment) override;
  void on_history(const control::History& history) override;
  void on_frame(const std::optional<FrameView>& frame, std::size_t bytes, TimeUs now) override;
  const std::string& name() const { return request_.subscribe.stream; }
  void say(const ControlMessage& message) { connection_->say(*this, message); }
  void forget_memory();  ///< REQUIRES: mutex_ is held.
  /// Errors: for the log. REQUIRES: mutex_ is held.
  Result<bool> decode(const FrameView& frame, TimeUs now);

  BrokerUrl url_;  ///< Changed by take() alone, as is request_, while no connection has it.
  BrokerConnection::Request request_;
  const std::function<void()> wake_;

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_):
  FrameDecoder decoder_;
  std::uint32_t epoch_ = 0;
  bool is_past_ = false;  ///< What comes now.
  std::optional<Rewind::Kept> kept_;
  std::vector<std::string> segments_;  ///< Of its memory, as announced.
  std::deque<control::Trace> traces_;  ///< Bounded, newest kept.
  News news_;
  Condition condition_;
  TimeUs notice_until_us_ = 0, late_said_us_ = 0;
  std::optional<control::Moment> moment_;
  std::uint64_t unreadable_ = 0;
  bool crowded_out_ = false;  ///< Another connection is to be asked for the stream.
  bool misplaced_ = false;    ///< Refused before it was ever open: the broker may be behind a path.

  std::shared_ptr<BrokerConnection> connection_;  ///< For the constructor, the destructor and take() alone.
};

}  // namespace eigencast
