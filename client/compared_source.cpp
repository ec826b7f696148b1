// SPDX-License-Identifier: MIT
#include "client/compared_source.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "common/core/clock.h"
#include "common/motion/clip_motion.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

constexpr std::size_t kMaxPoses = 128;
/// Of the shortest ways of two streams from their senders' clocks to ours: closer ones are of one clock.
constexpr TimeUs kOneClockUs = 50'000;

/// r x 3, row-major.
std::vector<double> positions_of(std::span<const double> C, std::uint32_t channels) {
  std::vector<double> result(C.size() / channels * 3);
  for (std::size_t i = 0; i < result.size(); ++i) result[i] = C[i / 3 * channels + i % 3];
  return result;
}

/// The last poses of a source, by capture time.
class PastPoses {
 public:
  void add(const std::vector<ReceivedPose>& poses) {
    for (const ReceivedPose& pose : poses) {
      if (epoch_ != pose.envelope.epoch) *this = {};
      epoch_ = pose.envelope.epoch;
      way_us_ = std::min(way_us_, pose.arrival_us - pose.envelope.capture_us);
      if (!times_us_.empty() && pose.envelope.capture_us <= times_us_.back()) continue;
      times_us_.push_back(pose.envelope.capture_us);
      poses_.push_back(positions_of({pose.coefficients.begin(), pose.coefficients.end()}, pose.channels));
      if (poses_.size() <= kMaxPoses) continue;
      times_us_.erase(times_us_.begin());
      poses_.erase(poses_.begin());
    }
  }
  bool empty() const { return poses_.empty(); }
  TimeUs way_us() const { return way_us_; }
  std::uint32_t epoch() const { return epoch_; }
  TimeUs newest_us() const { return times_us_.back(); }
  /// Interpolated as a playout does it; before the first and behind the last these. REQUIRES: !empty().
  std::vector<double> at(TimeUs capture_us) const {
    return ClipMotion{poses_, times_us_, 0, false}.at(capture_us, false);
  }

 private:
  std::uint32_t epoch_ = 0;
  std::vector<TimeUs> times_us_;
  std::vector<std::vector<double>> poses_;
  TimeUs way_us_ = std::numeric_limits<TimeUs>::max();  ///< From the sender's clock to ours, the shortest so far.
};

class Compared final : public PoseSource, private Truth {
 public:
  Compared(std::unique_ptr<PoseSource> source, std::unique_ptr<PoseSource> other)
      : source_(std::move(source)), other_(std::move(other)) {}

  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override {
    auto poses = source_->poll(timeout);
    mine_.add(poses);
    Timeline* const mine = source_->timeline();
    Timeline* const its = other_->timeline();
    if (mine != nullptr && its != nullptr && !mine_.empty()) {
      const TimeUs now_us = steady_now_us();
      its->set_paused(true, now_us);
      its->seek(mine->at(mine_.newest_us()).position_us, now_us);
      its->set_interpolates(true);
    }
    its_.add(other_->poll(std::chrono::milliseconds(0)));
    return poses;
  }
  const Asset* asset() const override { return source_->asset(); }
  std::uint32_t epoch() const override { return source_->epoch(); }
  const ChangeOver* change() const override { return source_->change(); }
  const std::optional<control::StreamInfo>& info() const override { return source_->info(); }
  Subscriber::Stats stats() const override { return source_->stats(); }
  TimeUs utc_us(TimeUs capture_us) const override { return source_->utc_us(capture_us); }
  std::optional<SharedMoment> moment() const override { return source_->moment(); }
  void report_late(TimeUs needed_lag_us) override { source_->report_late(needed_lag_us); }
  Truth* truth() const override { return const_cast<Compared*>(this); }
  Timeline* timeline() const override { return source_->timeline(); }
  Rewind* rewind() override { return source_->rewind(); }
  std::span<const std::vector<double>> motion() const override { return source_->motion(); }

 private:
  bool errors(std::span<const double> C, std::uint32_t channels, std::optional<TimeUs> capture_us,
              std::span<const float>, std::span<float> errors) override {
    difference_.reset();
    const auto& mine = source_->info();
    const auto& its = other_->info();
    const Asset* asset = source_->asset();
    if (its_.empty() || !its || !mine || asset == nullptr || its->epoch != its_.epoch()) {
      why_ = "what it is compared with has no pose yet: " + other_->stats().detail;
      return false;
    }
    if (its->asset != mine->asset || mine->asset.empty()) {
      why_ = "they show different surfaces: only streams of one asset can be compared";
      return false;
    }
    if (followed_ != source_->epoch()) reconstructor_.reset();
    followed_ = source_->epoch();
    if (asset->rows_ready > reconstructor_.tiles().rows()) reconstructor_.update(*asset);
    const auto N = static_cast<std::uint32_t>(errors.size());
    const std::vector<double> A = positions_of(C, channels),
                              B = its_.at(capture_us ? time_of(*capture_us) : its_.newest_us());
    if (A.size() != B.size() || N > reconstructor_.tiles().rows()) return false;
    for (std::vector<float>& positions : positions_) positions.resize(3 * errors.size());
    const std::array<PoseToRebuild, 2> both{{{A, 3, positions_[0]}, {B, 3, positions_[1]}}};
    reconstructor_.rebuild(both, asset->rank, N);
    float largest = 0;
    for (std::size_t i = 0; i < errors.size(); ++i) {
      const float x = positions_[0][3 * i] - positions_[1][3 * i],
                  y = positions_[0][3 * i + 1] - positions_[1][3 * i + 1],
                  z = positions_[0][3 * i + 2] - positions_[1][3 * i + 2];
      errors[i] = std::sqrt(x * x + y * y + z * z);
      largest = std::max(largest, errors[i]);
    }
    double squares = 0;  // The basis is orthonormal (docs/maths.md).
    for (std::size_t i = 0; i < A.size(); ++i) squares += (A[i] - B[i]) * (A[i] - B[i]);
    difference_ = Difference{std::sqrt(squares / asset->area) / asset->diagonal(),
                             static_cast<double>(largest) / asset->diagonal()};
    return true;
  }
  std::string why() const override { return why_; }
  std::optional<Difference> difference() const override { return difference_; }

  /// On the other sender's clock.
  TimeUs time_of(TimeUs capture_us) const {
    if (source_->timeline() != nullptr || other_->timeline() != nullptr) return its_.newest_us();
    const TimeUs apart_us = mine_.way_us() - its_.way_us();
    return std::abs(apart_us) < kOneClockUs ? capture_us : capture_us + apart_us;
  }

  const std::unique_ptr<PoseSource> source_, other_;
  PastPoses mine_, its_;
  Reconstructor reconstructor_;
  std::uint32_t followed_ = 0;
  std::array<std::vector<float>, 2> positions_;
  std::optional<Difference> difference_;
  std::string why_;
};

}  // namespace

std::unique_ptr<PoseSource> compared(std::unique_ptr<PoseSource> source, std::unique_ptr<PoseSource> other) {
  return std::make_unique<Compared>(std::move(source), std::move(other));
}

}  // namespace eigencast
