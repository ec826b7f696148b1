// SPDX-License-Identifier: MIT
#include "sender/growing_bake.h"

#include <utility>

#include "common/command_line/progress.h"
#include "common/core/clock.h"
#include "sender/live.h"

namespace eigencast {
namespace {

constexpr TimeUs kPollUs = 20'000;

}  // namespace

GrowingBake::GrowingBake(const SourceOptions& options, OpenedSource opened)
    : options_(options), opened_(std::move(opened)), thread_([this] { run(); }) {}

GrowingBake::~GrowingBake() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void GrowingBake::run() {
  if (opened_.clip == nullptr) {
    if (const auto good = store(opened_.clip, open_source(options_)); !good) return give(good.error(), true);
  }
  auto whole = bake_clip(
      options_, opened_, [this](double fraction, std::string_view stage) { return report(fraction, stage); }, findings_,
      options_.waits ? nullptr : std::function([this](BakeResult& first) { give(std::move(first), false); }));
  std::unique_lock lock(mutex_);
  if (!first_ && !stopped_ && !is_given_) {
    lock.unlock();
    return give(std::move(whole), true);
  }
  changed_.wait(lock, [&] { return stopped_ || whole_; });
  if (stopped_) return;
  const auto use = whole_;
  lock.unlock();
  use(whole);
}

void GrowingBake::give(Result<BakeResult> result, bool is_whole) {
  const std::lock_guard lock(mutex_);
  first_ = std::move(result);
  first_is_whole_ = is_whole;
  is_given_ = true;
}

bool GrowingBake::report(double fraction, std::string_view stage) {
  std::unique_lock lock(mutex_);
  fraction_ = fraction;
  stage_ = stage;
  const bool goes_on = !stopped_;
  const auto progress = progress_;
  lock.unlock();
  if (progress) progress(fraction);
  return goes_on;
}

Result<BakeResult> GrowingBake::first(const Console& console, Interrupt& interrupt) {
  ProgressLine line(console.progress, stops_at(interrupt));
  std::unique_lock lock(mutex_);
  while (!first_) {
    const double fraction = fraction_;
    const std::string stage = stage_;
    lock.unlock();
    const bool goes_on = line(fraction, stage) && !interrupt.wait_until(steady_now_us() + kPollUs);
    lock.lock();
    if (!goes_on) return fail(ErrorCode::kCancelled, "stopped while baking");
  }
  Result<BakeResult> result = *std::exchange(first_, std::nullopt);
  is_whole_ = first_is_whole_;
  lock.unlock();
  line.finish();
  if (!result) return result;
  log_bake(*result);
  log_clip(clip());
  for (const std::string& finding : findings_) log(to_log(), LogLevel::kWarning, finding);
  log(to_log(), LogLevel::kInfo,
      clip().name() + ": " + std::to_string(result->asset.vertex_count) + " vertices, r = " +
          std::to_string(result->asset.rank) + ", asset " + result->encoded.manifest.id.hex().substr(0, 12) +
          (result->from_cache ? ", from the cache"
           : is_whole_        ? ""
                              : ": coarse, until all of the basis is there"));
  return result;
}

void GrowingBake::then(std::function<void(Result<BakeResult>&)> whole, std::function<void(double)> progress) {
  {
    const std::lock_guard lock(mutex_);
    whole_ = std::move(whole);
    progress_ = std::move(progress);
  }
  changed_.notify_all();
}

}  // namespace eigencast
