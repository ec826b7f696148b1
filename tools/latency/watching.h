// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/core/log.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/subscriber.h"
#include "tools/latency/over_time.h"
#include "tools/latency/presenter.h"
#include "tools/latency/session.h"
#include "tools/latency/timeline.h"

namespace eigencast::latency {

/// Whether the broker of that URL shares our steady clock.
bool on_this_machine(const std::string& url);

class Watching {
 public:
  /// Begins to connect. Errors: those of subscribers and presenters.
  static Result<std::unique_ptr<Watching>> create(const Inputs& inputs, bool one_clock, const LogSink& log);
  ~Watching() { stop(); }
  void stop();
  /// Counts the poses whose capture times lie from begin() to end().
  void begin(TimeUs from_us) { from_us_ = from_us; }
  void end(TimeUs until_us) { until_us_ = until_us; }
  bool has_surface() const { return first_surface_us_ != 0; }
  bool has_whole_surface() const { return whole_asset_us_ != 0; }
  struct Connection {
    Subscriber::State state = Subscriber::State::kConnecting;
    std::string detail;  ///< For people.
  };
  Connection connection() const;
  Progress progress() const;
  /// After stop().
  void report_to(Outcome& outcome);

 private:
  Watching(const Inputs& inputs, bool one_clock, TimeUs start_us);
  Result<void> prepare();
  void run();
  void take(const ReceivedPose& pose, TimeUs taken_us);
  void count(const ReceivedPose& pose, TimeUs shown_us);
  bool counts(const ReceivedPose& pose) const;
  void take_traces();

  const Inputs inputs_;
  const bool one_clock_;
  const TimeUs start_us_;
  std::unique_ptr<Subscriber> subscriber_;
  std::unique_ptr<Presenter> presenter_;  ///< Lives and dies on the thread.
  Reconstructor reconstructor_;
  std::uint32_t reconstructed_epoch_ = 0;
  std::vector<float> positions_;
  DisplayAge age_;
  Timeline timeline_;
  std::set<std::pair<std::uint64_t, std::uint8_t>> seen_;  ///< Holds the newest keys.
  TimeUs newest_capture_us_ = 0;
  Subscriber::Stats at_begin_;
  TimeUs counted_from_us_ = 0;
  std::atomic<bool> stopping_{false};
  std::atomic<TimeUs> from_us_{0}, until_us_{0}, first_surface_us_{0}, whole_asset_us_{0};
  TimeUs first_picture_us_ = 0;
  mutable std::mutex mutex_;
  Connection connection_;  ///< GUARDED_BY(mutex_)
  Outcome outcome_;        ///< GUARDED_BY(mutex_) for what progress() reads.
  std::thread thread_;
};

}  // namespace eigencast::latency
