// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include "common/core/log.h"
#include "sdk/publisher.h"
#include "tools/latency/hdr_histogram.h"
#include "tools/latency/outcome.h"

namespace eigencast::latency {

/// How long a sender may take until it is live, and a viewer until it has a pose.
inline constexpr TimeUs kConnectPatienceUs = 20'000'000;

/// Poses on an open-loop schedule, each stamped with the time it was meant for, from a thread of its own.
class Sending {
 public:
  /// Begins to connect. Errors: those of clips, bakes and publishers.
  static Result<std::unique_ptr<Sending>> create(const Inputs& inputs, const LogSink& log);
  ~Sending() { stop(); }

  /// Errors: kTimeout, kRefused (by the broker), kCancelled (stop was set).
  Result<void> wait_until_live(const std::atomic<bool>& stop) const;
  void start();
  void stop();
  /// By the times they are meant for.
  void begin(TimeUs from_us) { from_us_ = from_us; }
  void end(TimeUs until_us) { until_us_ = until_us; }
  std::uint64_t sent() const { return sent_; }
  std::uint64_t missed() const { return missed_; }
  std::uint64_t dropped() const { return dropped_; }
  const HdrHistogram& lag_us() const { return lag_us_; }  ///< After stop().

 private:
  explicit Sending(const Inputs& inputs) : interval_us_(1e6 / inputs.rate_hz) {}
  void run();
  bool counts(TimeUs intended_us) const;

  const double interval_us_;
  std::vector<std::vector<float>> poses_;
  std::unique_ptr<Publisher> publisher_;
  std::atomic<bool> stopping_{false};
  std::atomic<TimeUs> from_us_{0}, until_us_{0};
  std::atomic<std::uint64_t> sent_{0}, missed_{0}, dropped_{0};
  HdrHistogram lag_us_;
  std::thread thread_;
};

}  // namespace eigencast::latency
