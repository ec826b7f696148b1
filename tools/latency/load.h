// SPDX-License-Identifier: MIT
#pragma once

#include <time.h>

#include <cstdint>
#include <memory>
#include <string>

#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "tools/latency/hdr_histogram.h"

namespace eigencast::latency {

/// What a clock of clock_gettime() shows.
double seconds_of(clockid_t clock);

/// Many light viewers on one thread: each checks that every key follows the one before it and acknowledges; none
/// rebuilds a surface. Measures its own cost, to say when it, and not the broker, was what limited.
class Load {
 public:
  struct Options {
    std::string url;  ///< ws://host:port/stream, numeric host or name.
    std::uint32_t viewers = 0;
    Profile profile = {};
    Credentials credentials = {};
    TimeUs ack_every_us = 100'000;
  };
  struct Figures {
    std::uint64_t viewers = 0;  ///< Connected at the end.
    std::uint64_t refused = 0;  ///< Never connected, or lost.
    std::uint64_t frames = 0;
    std::uint64_t bytes = 0;
    std::uint64_t keys_missed = 0;  ///< Gaps in the numbers of keys: superseded on the way.
    std::uint64_t undecodable = 0;  ///< Frames that build on a key that this viewer does not have.
    HdrHistogram latency_us;        ///< Read minus capture; meaningful where the sender shares our clock.
    HdrHistogram lag_us;            ///< How late its own thread was.
    double cpu_share = 0;           ///< Its thread's, of one core.
    bool was_bottleneck() const { return cpu_share > 0.8 || lag_us.percentile(99) > 20'000; }
  };

  /// Errors: kInvalidArgument (no URL, or one of TLS).
  static Result<BrokerUrl> check_url(const std::string& text);
  /// Returns when all are watching or `patience_us` is over.
  /// Errors: those of check_url and of credentials, kUnreachable (none could connect), kTooLarge (file descriptors).
  static Result<std::unique_ptr<Load>> start(const Options& options, TimeUs patience_us);
  virtual ~Load() = default;
  /// What is counted begins now.
  virtual void begin() = 0;
  virtual Figures finish() = 0;
};

}  // namespace eigencast::latency
