// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "client/clip_source.h"

namespace eigencast {

/// A clip that is baked on a thread of its own, then plays as ClipSource does. kDownloading until then, or kRefused.
///
/// A watched clip is read again when its files have changed and were stable for half a second. The old one plays until
/// the new one is ready, and stays if that cannot be read; then `detail` says why. Use from one thread.
class OpeningClip final : public PoseSource {
 public:
  static constexpr std::chrono::milliseconds kPollInterval{500};  ///< Between checks of watched files.

  OpeningClip(std::string input, std::string cache_dir, bool watch = false);
  /// Stops baking at its next report of progress, and waits for that.
  ~OpeningClip() override;

  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override;
  const Asset* asset() const override { return playing_ ? playing_->asset() : nullptr; }
  std::uint32_t epoch() const override { return playing_ ? playing_->epoch() : 0; }
  const std::optional<control::StreamInfo>& info() const override { return playing_ ? playing_->info() : info_; }
  Subscriber::Stats stats() const override;
  Truth* truth() const override { return playing_ ? playing_->truth() : nullptr; }

 private:
  void bake(const std::string& input, const std::string& cache_dir);
  void watch(const std::string& input, const std::string& cache_dir);
  bool pause();

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

}  // namespace eigencast
