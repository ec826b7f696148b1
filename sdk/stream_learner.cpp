// SPDX-License-Identifier: MIT
#include "sdk/stream_learner.h"

#include <algorithm>
#include <cassert>
#include <optional>
#include <string>
#include <utility>

#include "common/asset/format/columns.h"
#include "common/core/text.h"
#include "common/net/guarded_run.h"

namespace eigencast {
namespace {

constexpr TimeUs kFirstDecisionUs = 3'000'000, kLastDecisionUs = 300'000'000;
constexpr TimeUs kIntervalUs = 30'000;  ///< Between poses that are learnt from, at least.

}  // namespace

/// Of one asset.
class StreamLearner::Pupil {
 public:
  Pupil(LearnUse use, Job job, const LogSink& log) : use_(use), job_(std::move(job)), log_(log), learner_(job_.asset) {}

  const std::shared_ptr<const Asset>& asset() const { return job_.asset; }
  /// True: it has nothing more to learn.
  bool is_over() const { return over_; }
  void give_up(const Error& why) { end("no columns are learnt: " + why.message); }

  /// What it has learnt, once.
  std::optional<LearntAsset> add(const Pose& pose) {
    if (poses_ == 0) first_us_ = pose.capture_us, due_us_ = first_us_ + kFirstDecisionUs;
    learner_.add(pose.positions, pose.C);
    ++poses_;
    if (pose.capture_us < due_us_) return std::nullopt;
    const TimeUs seen_us = pose.capture_us - first_us_;
    auto learnt = decide(seen_us);
    due_us_ = first_us_ + 2 * seen_us;
    over_ |= learnt.has_value() || 2 * seen_us > kLastDecisionUs;
    return learnt;
  }

 private:
  std::optional<LearntAsset> decide(TimeUs seen_us) {
    const double seconds = static_cast<double>(seen_us) * 1e-6;
    const std::string after = formatted("after %.0f s: ", seconds);
    const auto trial = learner_.trial(job_.eps, static_cast<double>(poses_ - 1) / seconds);
    if (!trial) return decline(after + "too few poses came");
    const double percent = 100 / job_.asset->diagonal();
    const std::string errors = formatted("the basis misses %.3f %% of the diagonal, coding adds %.3f",
                                         percent * trial->basis_error, percent * trial->coding_error);
    if (use_ == LearnUse::kAuto && trial->basis_error <= trial->coding_error) return decline(after + errors);
    const LearntColumns columns = learner_.columns(job_.eps);
    if (columns.amplitudes.empty()) return decline(after + errors + ": all columns are finer than coding");
    const auto encoded = encode_columns(*job_.asset, *job_.encoded, columns.columns);
    if (!encoded) return give_up(encoded.error()), std::nullopt;
    const std::uint64_t bytes = encoded->section.bytes.size() + encoded->manifest.bytes.size();
    const auto payback_s = trial->payback_s(bytes);
    const std::string cost =
        formatted("%zu columns of %.1f kB", columns.amplitudes.size(), static_cast<double>(bytes) * 1e-3) +
        (payback_s ? formatted(", paid back in %.0f s", *payback_s) : ", never paid back");
    if (use_ == LearnUse::kAuto && !trial->pays(bytes)) return decline(after + errors + "; " + cost);
    auto wider = learnt_asset(*job_.asset, *encoded);
    if (!wider) return give_up(wider.error()), std::nullopt;
    log(log_, LogLevel::kInfo,
        "learns " + after + errors + "; " + cost +
            formatted("; error of poses not learnt from, at as many bits: %.3f %%", percent * trial->equal_error));
    return LearntAsset{std::make_shared<const Asset>(*std::move(wider)),
                       std::make_shared<const EncodedAsset>(encoded->with(*job_.encoded)), trial->coarser};
  }

  std::optional<LearntAsset> decline(const std::string& why) {
    log(log_, LogLevel::kInfo, "learns no columns " + why);
    return std::nullopt;
  }
  void end(const std::string& why) {
    log(log_, LogLevel::kInfo, why);
    over_ = true;
  }

  const LearnUse use_;
  const Job job_;
  const LogSink& log_;
  Learner learner_;
  std::size_t poses_ = 0;
  TimeUs first_us_ = 0, due_us_ = 0;
  bool over_ = false;
};

StreamLearner::StreamLearner(LearnUse use, Use take, LogSink sink)
    : use_(use), take_(std::move(take)), log_(std::move(sink)) {
  assert(use != LearnUse::kOff);
  thread_ = std::thread([this] {
    guarded_run([this] { run(); },
                [this](const std::string& what) {
                  end();  // Memory that ran out does so again.
                  log(log_, LogLevel::kError, "no columns are learnt: " + what);
                });
  });
}

StreamLearner::~StreamLearner() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void StreamLearner::begin(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded, double eps) {
  {
    const std::lock_guard lock(mutex_);
    job_ = {std::move(asset), std::move(encoded), eps};
    ++jobs_;
    is_idle_ = has_pose_ = false;
    last_us_ = 0;
  }
  changed_.notify_all();
}

bool StreamLearner::wants(TimeUs capture_us) const {
  const std::lock_guard lock(mutex_);
  return is_idle_ && !has_pose_ && capture_us >= last_us_ + kIntervalUs;
}

void StreamLearner::add(std::span<const float> positions, std::span<const double> C, TimeUs capture_us) {
  {
    const std::lock_guard lock(mutex_);
    pose_.positions.assign(positions.begin(), positions.end());
    pose_.C.assign(C.begin(), C.end());
    pose_.capture_us = last_us_ = capture_us;
    has_pose_ = true;
  }
  changed_.notify_all();
}

void StreamLearner::run() {
  std::uint64_t jobs = 0;
  std::optional<Pupil> pupil;
  Pose pose;
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [&] { return stopped_ || jobs != jobs_ || has_pose_; });
    if (stopped_) return;
    if (jobs != jobs_) {
      jobs = jobs_;
      const Job job = job_;
      lock.unlock();
      pupil.reset();
      if (job.asset) {
        if (const auto able = check_columns(*job.asset, 1); able)
          pupil.emplace(use_, job, log_);
        else
          log(log_, LogLevel::kInfo, "no columns are learnt: " + able.error().message);
      }
      lock.lock();
      is_idle_ = jobs == jobs_ && pupil;
      continue;
    }
    std::swap(pose, pose_);
    has_pose_ = is_idle_ = false;
    lock.unlock();
    const auto learnt = pupil->add(pose);
    if (learnt) take_(pupil->asset(), *learnt);
    if (pupil->is_over()) pupil.reset();
    lock.lock();
    is_idle_ = jobs == jobs_ && pupil;
  }
}

}  // namespace eigencast
