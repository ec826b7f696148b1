// SPDX-License-Identifier: MIT
#include "client/clip_truth.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <exception>
#include <limits>
#include <mutex>
#include <thread>

#include "client/clip_source.h"

namespace eigencast {

ClipTruth::ClipTruth(std::shared_ptr<const MotionClip> clip, std::vector<std::vector<double>> frames,
                     std::vector<std::uint32_t> source_vertex, const std::array<double, 3>& origin)
    : clip_(std::move(clip)), frames_(std::move(frames)), source_vertex_(std::move(source_vertex)), origin_(origin) {
  assert(!frames_.empty());
}

ClipTruth::Moment ClipTruth::moment_of(std::span<const double> C, std::uint32_t channels) const {
  const std::size_t rank = C.size() / channels;
  const auto value = [&](std::size_t i) { return C[i / 3 * channels + i % 3]; };
  const auto distance = [&](const std::vector<double>& frame) {
    double sum = 0;
    for (std::size_t i = 0; i < 3 * rank; ++i) sum += (value(i) - frame[i]) * (value(i) - frame[i]);
    return sum;
  };
  std::size_t nearest = 0;
  double closest = std::numeric_limits<double>::max();
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    if (const double d = distance(frames_[f]); d < closest) {
      closest = d;
      nearest = f;
    }
  }
  Moment best{nearest, 0};
  const std::size_t count = frames_.size();
  for (const std::size_t first : {(nearest + count - 1) % count, nearest}) {
    const std::vector<double>&a = frames_[first], &b = frames_[(first + 1) % count];
    double along = 0, length = 0;
    for (std::size_t i = 0; i < 3 * rank; ++i) {
      along += (value(i) - a[i]) * (b[i] - a[i]);
      length += (b[i] - a[i]) * (b[i] - a[i]);
    }
    if (length == 0) continue;
    const double part = std::clamp(along / length, 0.0, 1.0);
    double off = 0;
    for (std::size_t i = 0; i < 3 * rank; ++i) {
      const double d = value(i) - (a[i] + part * (b[i] - a[i]));
      off += d * d;
    }
    if (off < closest) {
      closest = off;
      best = {first, part};
    }
  }
  return best;
}

/// From one pose to the next the second frame often becomes the first: then the slots are swapped.
const std::vector<Vec3>* ClipTruth::frame(std::size_t number, std::size_t slot) {
  if (kept_[slot] != number && kept_[1 - slot] == number) {
    std::swap(kept_[0], kept_[1]);
    std::swap(positions_[0], positions_[1]);
  }
  if (kept_[slot] != number) {
    Result<std::vector<Vec3>> pose = clip_->pose(number);
    if (!pose) {
      why_ = "the truth cannot be read: " + pose.error().message;
      return nullptr;
    }
    positions_[slot] = std::move(*pose);
    kept_[slot] = number;
  }
  return &positions_[slot];
}

bool ClipTruth::errors(std::span<const double> C, std::uint32_t channels, std::optional<TimeUs>,
                       std::span<const float> positions, std::span<float> errors) {
  if (C.size() / channels * 3 != frames_.front().size() || errors.size() > source_vertex_.size()) {
    why_ = "the truth belongs to another surface";
    return false;
  }
  const Moment moment = moment_of(C, channels);
  const std::size_t second = (moment.first + 1) % frames_.size();
  const std::vector<Vec3>* a = frame(moment.first, 0);
  if (a == nullptr) return false;
  const std::vector<Vec3>* b = moment.part == 0 || second == moment.first ? a : frame(second, 1);
  if (b == nullptr) return false;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const std::uint32_t source = source_vertex_[i];
    double sum = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      const double truth = (1 - moment.part) * (*a)[source][d] + moment.part * (*b)[source][d] - origin_[d];
      const double off = static_cast<double>(positions[3 * i + d]) - truth;
      sum += off * off;
    }
    errors[i] = static_cast<float>(std::sqrt(sum));
  }
  return true;
}

namespace {

class LateTruth final : public Truth {
 public:
  bool errors(std::span<const double> C, std::uint32_t channels, std::optional<TimeUs> capture_us,
              std::span<const float> positions, std::span<float> errors) override {
    const std::lock_guard lock(mutex_);
    return made_ && made_->errors(C, channels, capture_us, positions, errors);
  }
  std::string why() const override {
    const std::lock_guard lock(mutex_);
    return made_ ? made_->why() : why_;
  }
  void set(std::unique_ptr<ClipTruth> made, std::string why) {
    const std::lock_guard lock(mutex_);
    made_ = std::move(made);
    why_ = std::move(why);
  }

 private:
  mutable std::mutex mutex_;
  std::unique_ptr<ClipTruth> made_;
  std::string why_ = "the truth waits for the whole surface";
};

Result<std::unique_ptr<ClipTruth>> truth_from(const std::string& file, const Asset& asset,
                                              const BakeProgress& progress) {
  auto clip = open_input(file);
  if (!clip) return clip.error();
  if ((*clip)->rest().positions.size() != asset.vertex_count)
    return fail(ErrorCode::kInvalidArgument, file + " has " + std::to_string((*clip)->rest().positions.size()) +
                                                 " vertices, the stream's surface " +
                                                 std::to_string(asset.vertex_count) + ": it is not its truth");
  auto frames = project_clip(**clip, asset, progress);
  if (!frames) return frames.error();
  return std::make_unique<ClipTruth>(std::shared_ptr<const MotionClip>(std::move(*clip)), std::move(*frames),
                                     asset.source_vertex, asset.origin);
}

class TruthfulSource final : public PoseSource {
 public:
  TruthfulSource(std::unique_ptr<PoseSource> source, std::string file)
      : source_(std::move(source)), file_(std::move(file)) {}
  ~TruthfulSource() override {
    stop_.store(true);
    if (thread_.joinable()) thread_.join();
  }
  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override {
    auto poses = source_->poll(timeout);
    const Asset* asset = source_->asset();
    if (asset != nullptr && asset->complete() && source_->epoch() != epoch_) begin(*asset);
    return poses;
  }
  const Asset* asset() const override { return source_->asset(); }
  std::uint32_t epoch() const override { return source_->epoch(); }
  const std::optional<control::StreamInfo>& info() const override { return source_->info(); }
  Subscriber::Stats stats() const override { return source_->stats(); }
  TimeUs utc_us(TimeUs capture_us) const override { return source_->utc_us(capture_us); }
  std::optional<SharedMoment> moment() const override { return source_->moment(); }
  void report_late(TimeUs needed_lag_us) override { source_->report_late(needed_lag_us); }
  Truth* truth() const override { return &truth_; }

 private:
  /// Starts anew for each epoch, which may have another basis.
  void begin(const Asset& asset) {
    epoch_ = source_->epoch();
    stop_.store(true);
    if (thread_.joinable()) thread_.join();
    stop_.store(false);
    truth_.set(nullptr, "the truth is being prepared");
    thread_ = std::thread([this, asset] {
      const auto go_on = [this](double, std::string_view) { return !stop_.load(); };
      try {
        auto made = truth_from(file_, asset, go_on);
        made ? truth_.set(std::move(*made), "") : truth_.set(nullptr, "no truth: " + made.error().message);
      } catch (const std::exception& error) {
        truth_.set(nullptr, std::string("no truth: ") + error.what());
      }
    });
  }

  std::unique_ptr<PoseSource> source_;
  const std::string file_;
  mutable LateTruth truth_;
  std::atomic<bool> stop_{false};
  std::uint32_t epoch_ = 0;
  std::thread thread_;
};

}  // namespace

std::unique_ptr<PoseSource> with_truth(std::unique_ptr<PoseSource> source, std::string file) {
  return std::make_unique<TruthfulSource>(std::move(source), std::move(file));
}

}  // namespace eigencast
