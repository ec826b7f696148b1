// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/core/histogram.h"
#include "common/core/log.h"
#include "common/core/memory_budget.h"
#include "common/motion/coefficients.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/frame_decoder.h"

namespace eigencast {

struct ChangeOver;

struct SubscriberOptions {
  std::string url;                 ///< ws://host:port/stream[?rate=...]; several brokers: see common/net/url.h
  std::optional<Profile> profile;  ///< Overrides the URL's query.
  std::string cache_dir;           ///< Where downloaded chunks are kept; empty: nowhere.
  std::uint32_t trace_every = 0;   ///< Ask for traces of keys whose sequence is a multiple of it; 0: none.
  std::chrono::milliseconds declined_retry{5000};  ///< A broker that refused the stream is asked again after so long.
  Credentials credentials = {};                    ///< Token and trusted authorities; see common/net/url.h.
  std::string sync = {};                           ///< A group of viewers that show the same moment; empty: none.
  MemoryBudget* memory = nullptr;  ///< Bounds what its surface may take; outlives it. Null: received_memory().
};

struct ReceivedPose {
  /// A key whose poses are still to come.
  struct Next {
    TimeUs capture_us = 0;
    BandMask bands;
    Coefficients coefficients;
  };
  Envelope envelope;          ///< That of the pose, with its bands; where a key shows a pose up to it, of that step.
  TimeUs arrival_us = 0;      ///< Steady clock, when the last byte was read.
  TimeUs decoded_us = 0;      ///< Likewise, when it was decoded.
  Coefficients coefficients;  ///< Absent bands read as the rest pose (docs/protocol.md).
  std::uint32_t channels = 3;
  std::vector<std::uint32_t> band_ends = {};  ///< The row at which each band ends, as announced with the pose.
  std::optional<Next> next = {};              ///< Set once for each key that came ahead; as large as `coefficients`.
};

/// The past of a stream, as far as its broker keeps that and the caller may see it again (docs/protocol.md, "seek").
/// Times are microseconds since 1970 on the broker's clock. As Subscriber, which it is a part of.
class Rewind {
 public:
  struct Kept {
    TimeUs now_us = 0;                          ///< When the broker said it,
    TimeUs heard_us = 0;                        ///< on our steady clock.
    std::vector<control::History::Span> spans;  ///< Ascending; of the time between them there is nothing.
    std::string trouble;                        ///< Why the last seek was not done; empty: all is well.
    std::uint64_t refusals = 0;                 ///< Of seeks so far.

    TimeUs now_at(TimeUs steady_us) const { return now_us + steady_us - heard_us; }
  };

  virtual ~Rewind() = default;
  /// As the broker said last; nothing: it keeps nothing, or the caller may not see it.
  virtual std::optional<Kept> kept() const = 0;
  virtual void ask_kept() = 0;
  /// Shows the newest pose at that time, with `next` the first one after it, then what followed at that speed; 0: that
  /// pose alone. Subscriber::info() says what is shown then; where it is not done refusals grow.
  virtual void seek(TimeUs at_us, double speed, bool next = false) = 0;
  virtual void show_present() = 0;
};

/// Which pose a group of viewers shows: at t on our clock that of t - lag_us. See control::Moment.
struct SharedMoment {
  TimeUs lag_us = 0;
  TimeUs delay_us = 0;  ///< So much of it is behind the fastest arrivals.
};

/// Watches one stream: downloads the asset chunk by chunk (cache first), decodes frames, acknowledges, reconnects by
/// itself, and keeps what it has meanwhile. Two threads serve all Subscribers of a broker with the same credentials;
/// what they found is handed over inside poll(), so that asset() and what poll returned need no lock. Use from one
/// thread; different Subscribers are independent. The log is called on those threads: it must neither make nor destroy
/// a Subscriber, nor wait for a thread that does.
class Subscriber : public Rewind {
 public:
  enum class State { kConnecting, kWaiting, kDownloading, kLive, kStalled, kLost, kRefused };
  struct Stats : FrameDecoder::Counts {
    State state = State::kConnecting;
    std::string detail;                   ///< For people: what is going on, why, and when the next try starts.
    std::uint64_t frames = 0, bytes = 0;  ///< Frames only, envelopes included; see link_bytes().
    std::uint64_t recalled = 0;           ///< Keys of them that were predicted from a memory of poses, and
    std::uint64_t memory_bytes = 0;       ///< what was fetched of such memories.
    std::uint64_t dropped = 0;            ///< Frames that newer ones overtook in the broker, as its notices say.
    std::uint64_t asset_bytes_downloaded = 0, asset_bytes_cached = 0, asset_bytes_total = 0;
    std::uint64_t reconnects = 0;
    std::optional<TimeUs> retry_in;  ///< Until the next try to connect, or to ask again for a stream that was declined.
    std::optional<TimeUs> clock_offset_us, clock_error_us, rtt_us;  ///< Relate to the broker.
    Histogram latency_us;          ///< Arrival minus capture time, for a sender on this machine's clock.
    bool surface_refused = false;  ///< kRefused here, for its memory or its bytes, not by the broker.
  };

  /// Errors: kInvalidArgument (URL, stream name).
  static Result<std::unique_ptr<Subscriber>> create(SubscriberOptions options, LogSink log = {});
  /// Waits at most `timeout` for news; poses oldest first (at most 64: older ones are dropped).
  virtual std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) = 0;

  /// Holds what has arrived; null before the first chunk. Changes only inside poll(); a new epoch's asset replaces
  /// the old one once it can be drawn.
  virtual const Asset* asset() const = 0;
  /// How asset() came in place of that of the epoch before; null: it has nothing to do with that.
  virtual const ChangeOver* change() const = 0;
  virtual std::uint32_t epoch() const = 0;  ///< Belongs to asset(); 0 before.
  /// Is the one announced last; nothing before, or after the broker refused it.
  virtual const std::optional<control::StreamInfo>& info() const = 0;
  virtual Stats stats() const = 0;
  /// With `sync`; nothing: that is not known (yet).
  virtual std::optional<SharedMoment> moment() const { return std::nullopt; }
  /// With `sync`: Playout::needed_lag_us(), on our clock; with streams of several brokers, as far behind the fastest
  /// arrivals as any of these needs.
  virtual void report_late(TimeUs /*needed_lag_us*/) {}
  /// Since the last call, oldest first (at most 256: older ones are dropped).
  virtual std::vector<control::Trace> take_traces() = 0;
};

}  // namespace eigencast
