// SPDX-License-Identifier: MIT
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/format/encode.h"
#include "common/core/clock.h"
#include "common/core/log.h"
#include "sdk/learner.h"
#include "sdk/publisher.h"

namespace eigencast {

/// What a stream learnt: its asset with columns.
struct LearntAsset {
  std::shared_ptr<const Asset> asset;
  std::shared_ptr<const EncodedAsset> encoded;
  double coarser = 1;  ///< See LearningTrial.
};

/// Learns what a stream's basis misses, on a thread of its own, once: decides after 3 s of poses, and again each time
/// that twice as many have come, for five minutes; the log says what and why. Knows no clock but the poses'. Use from
/// one thread.
class StreamLearner {
 public:
  /// Called at most once for each begin(), on the thread.
  using Use = std::function<void(const std::shared_ptr<const Asset>& from, const LearntAsset& learnt)>;

  /// use  not kOff; with kOn columns need not pay
  StreamLearner(LearnUse use, Use take, LogSink sink);
  ~StreamLearner();  ///< Waits for a decision under way.
  StreamLearner(const StreamLearner&) = delete;
  StreamLearner& operator=(const StreamLearner&) = delete;

  /// From the poses of this asset, which follow; what was learnt of another is forgotten. Never waits.
  ///   eps  as of quantiser_for_error, of the stream
  void begin(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded, double eps);
  /// Nothing more.
  void end() { begin(nullptr, nullptr, 0); }
  /// Whether add() may take the next pose: it came long enough after the last, and the thread is idle.
  bool wants(TimeUs capture_us) const;
  /// As Learner::add. Never waits. REQUIRES: wants(capture_us).
  void add(std::span<const float> positions, std::span<const double> C, TimeUs capture_us);

 private:
  struct Job {
    std::shared_ptr<const Asset> asset;
    std::shared_ptr<const EncodedAsset> encoded;
    double eps = 0;
  };
  struct Pose {
    std::vector<float> positions;
    std::vector<double> C;
    TimeUs capture_us = 0;
  };
  class Pupil;

  void run();

  const LearnUse use_;
  const Use take_;
  const LogSink log_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_):
  bool stopped_ = false;
  Job job_;                 ///< Null asset: none.
  std::uint64_t jobs_ = 0;  ///< Grows with each begin().
  bool is_idle_ = false;    ///< The thread waits for a pose of job_.
  bool has_pose_ = false;
  Pose pose_;
  TimeUs last_us_ = 0;

  std::thread thread_;  ///< Last: it uses all above.
};

}  // namespace eigencast
