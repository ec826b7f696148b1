// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "common/core/log.h"
#include "common/motion/clip_motion.h"
#include "common/motion/timeline.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "view/pose_source.h"

namespace eigencast {

/// A built-in shape, path, folder or glob. Errors: kNotFound, those of open_clip.
Result<std::unique_ptr<MotionClip>> open_input(const std::string& input);

/// Whether there is one of that name, or it is a glob. Errors: kNotFound.
Result<void> check_input(const std::string& input);

/// The coefficients of all frames, each r x 3. Errors: those of reading a frame; kTooLarge (over 1 GiB), kCancelled,
/// kNumerical. REQUIRES: asset.complete().
Result<std::vector<std::vector<double>>> project_clip(const MotionClip& clip, const Asset& asset,
                                                      const BakeProgress& progress = {});

/// A surface and all poses of its motion: of a file or built-in shape that was baked in this process, or of a stream.
struct BakedClip {
  std::string name, asset_id;
  std::string not_kept;  ///< Why the bake is not cached; empty if it is.
  Asset asset;
  double rate_hz = 30;
  std::shared_ptr<const MotionClip> motion;  ///< As read; pose() from one thread at a time. Null: of a stream.
  std::vector<std::vector<double>> frames;   ///< Each r x c, row-major; c is 3, more of a stream with scalars.
  std::vector<TimeUs> times_us;              ///< Of the frames, see ClipMotion.
  std::vector<TimeUs> utc_us;                ///< When each was captured; empty: of a file, which has no such time.
  TimeUs period_us = 0;
  bool is_cycle = false;
  std::optional<control::StreamInfo> info;  ///< As the stream's sender announced it.

  ClipMotion curve() const { return {frames, times_us, period_us, is_cycle}; }

  /// Bakes, or takes from cache_dir; of a recording reads. Warns of files of its look that are missing. Errors: those
  /// of open_input, bake, project_clip and read_recording.
  static Result<std::shared_ptr<const BakedClip>> open(const std::string& input, const std::string& cache_dir,
                                                       const BakeProgress& progress = {}, const LogSink& log = {});
};

/// Plays a clip without a broker, as its timeline() says. Capture times are due times.
class ClipSource final : public PoseSource {
 public:
  using Clock = std::function<TimeUs()>;
  /// phase_s: where in the clip it begins. clock: default is the steady clock; with another poll() never waits.
  /// epoch: > 0.
  explicit ClipSource(std::shared_ptr<const BakedClip> clip, double phase_s = 0, Clock clock = {},
                      std::uint32_t epoch = 1);

  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override;
  const Asset* asset() const override { return &clip_->asset; }
  std::uint32_t epoch() const override { return info_->epoch; }
  const std::optional<control::StreamInfo>& info() const override { return info_; }
  Subscriber::Stats stats() const override { return stats_; }
  TimeUs utc_us(TimeUs capture_us) const override;
  Truth* truth() const override { return truth_.get(); }
  Timeline* timeline() const override { return timeline_.get(); }
  std::span<const std::vector<double>> motion() const override { return clip_->frames; }

 private:
  /// Tells what poll() has returned from what is new.
  struct Shown {
    std::int64_t lap = 0;
    TimeUs position_us = 0;  ///< Of the frame, unless between frames.
    bool operator==(const Shown&) const = default;
  };
  Shown shown_at(TimeUs now_us) const;

  std::shared_ptr<const BakedClip> clip_;
  std::unique_ptr<Truth> truth_;
  bool waits_;
  Clock clock_;
  std::unique_ptr<Timeline> timeline_;  ///< Null without frames.
  std::optional<Shown> shown_;
  TimeUs last_capture_us_;
  std::optional<control::StreamInfo> info_;
  Subscriber::Stats stats_;
};

/// A clip that is baked on a thread of its own, then plays as ClipSource does. kDownloading until then, or kRefused.
///
/// A watched clip is read again when its files have changed and were stable for half a second. The old one plays until
/// the new one is ready, and stays if that cannot be read; then `detail` says why. Use from one thread.
class OpeningClip final : public PoseSource {
 public:
  static constexpr std::chrono::milliseconds kPollInterval{500};  ///< Between checks of watched files.

  /// log: as of BakedClip::open(); called from another thread.
  OpeningClip(std::string input, std::string cache_dir, bool watch = false, LogSink log = {});
  /// Stops baking at its next report of progress, and waits for that.
  ~OpeningClip() override;

  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override;
  const Asset* asset() const override { return playing_ ? playing_->asset() : nullptr; }
  std::uint32_t epoch() const override { return playing_ ? playing_->epoch() : 0; }
  const std::optional<control::StreamInfo>& info() const override { return playing_ ? playing_->info() : info_; }
  Subscriber::Stats stats() const override;
  TimeUs utc_us(TimeUs capture_us) const override { return playing_ ? playing_->utc_us(capture_us) : capture_us; }
  Truth* truth() const override { return playing_ ? playing_->truth() : nullptr; }
  Timeline* timeline() const override { return playing_ ? playing_->timeline() : nullptr; }
  std::span<const std::vector<double>> motion() const override {
    return playing_ ? playing_->motion() : PoseSource::motion();
  }

 private:
  void bake(const std::string& input, const std::string& cache_dir);
  void watch(const std::string& input, const std::string& cache_dir);
  bool pause();

  const LogSink log_;
  std::optional<control::StreamInfo> info_;
  std::unique_ptr<ClipSource> playing_;
  std::uint32_t times_read_ = 0;
  std::atomic<bool> stop_{false};
  mutable std::mutex mutex_;
  std::condition_variable stopping_;
  std::string detail_;                                            // guarded by mutex_
  std::optional<Result<std::shared_ptr<const BakedClip>>> made_;  // guarded by mutex_
  std::optional<std::string> failed_;
  std::thread thread_;  ///< Last: it uses the others.
};

/// INPUT of a stream's name "file:INPUT", or of the URL "file:///INPUT" without its escapes; nothing for streams of
/// brokers.
std::optional<std::string> clip_in(const std::string& stream);

}  // namespace eigencast
