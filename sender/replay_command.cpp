// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "common/codec/pose_memory.h"
#include "common/core/hash/sha256.h"
#include "common/wire/control.h"
#include "common/wire/limits.h"
#include "sdk/asset_folder.h"
#include "sdk/publisher.h"
#include "sdk/recorded_stream.h"
#include "sender/commands.h"
#include "sender/live.h"

namespace eigencast {
namespace {

constexpr TimeUs kPollUs = 100'000;
/// Longer pauses of the recording are cut to this.
constexpr TimeUs kLongestPauseUs = 5'000'000;

class Replayer {
 public:
  Replayer(const ReplayCommand& command, RecordedStream stream) : command_(command), stream_(std::move(stream)) {}

  Result<void> run(Interrupt& interrupt) {
    do {
      if (auto sought = stream_.seek(static_cast<TimeUs>(command_.from_s * 1e6)); !sought) return sought;
      const std::uint64_t before = sent_;
      const auto played = play_once(interrupt);
      if (!played) return played.error();
      if (!*played) return {};
      if (sent_ == before) return fail(ErrorCode::kInvalidArgument, "the recording has no pose there");
    } while (command_.loop);
    // What was sent last is still on its way.
    interrupt.wait_until(steady_now_us() + 300'000);
    return {};
  }

  nlohmann::json report() const {
    return {{"frames_sent", sent_},
            {"frames_dropped", dropped_},
            {"duration_s", stream_.info().duration_us * 1e-6},
            {"complete", stream_.info().complete}};
  }

 private:
  /// False: interrupted.
  Result<bool> play_once(Interrupt& interrupt) {
    const auto from_us = static_cast<TimeUs>(command_.from_s * 1e6);
    const TimeUs until_us =
        command_.duration_s > 0 ? from_us + static_cast<TimeUs>(command_.duration_s * 1e6) : stream_.info().duration_us;
    std::optional<TimeUs> last_us;
    std::optional<RecordedPose> held;  // The latest pose before the beginning: what was to be seen then.
    for (;;) {
      auto event = stream_.next();
      if (!event) return in_context(command_.file, event.error());
      if (!*event || (**event).time_us > until_us) return true;
      auto& [time_us, what] = **event;
      if (const auto* announce = std::get_if<control::Announce>(&what)) begin(*announce);
      if (auto* memory = std::get_if<RecordedStream::Memory>(&what)) to_remember_ = std::move(*memory);
      auto* pose = std::get_if<RecordedPose>(&what);
      if (pose == nullptr) continue;
      if (time_us < from_us) {
        held = std::move(*pose);
        continue;
      }
      if (!publisher_) {
        const auto live = go_live(interrupt);
        if (!live) return live.error();
        if (!*live) return false;
      }
      if (held && !send(*std::exchange(held, std::nullopt), from_us, last_us, interrupt)) return false;
      if (!send(std::move(*pose), time_us, last_us, interrupt)) return false;
      if (const auto ours = check_ownership(*publisher_); !ours) return ours.error();
    }
  }

  /// `time_us` runs with the recording.
  bool send(RecordedPose pose, TimeUs time_us, std::optional<TimeUs>& last_us, Interrupt& interrupt) {
    const TimeUs now_us = steady_now_us();
    if (last_us) {
      const TimeUs pause_us = std::min(time_us - *last_us, kLongestPauseUs);
      due_us_ += static_cast<TimeUs>(std::llround(static_cast<double>(pause_us) / command_.speed));
    } else {
      due_us_ = std::max(due_us_ + 1, now_us);
    }
    last_us = time_us;
    if (interrupt.wait_until(due_us_)) return false;
    // Even when the recording's arrivals came in a burst, captures grow.
    capture_us_ = std::max(capture_us_ + 1, due_us_);
    // Until the broker has the memory keys are coded exactly, as any that need none.
    if (!to_remember_.empty() && !publisher_->memory().pending)
      (void)publisher_->remember(std::exchange(to_remember_, {}));
    const SendStatus sent = publisher_->send_key(std::move(pose.key), capture_us_, pose.coded, pose.phase);
    sent == SendStatus::kSent ? ++sent_ : ++dropped_;
    return true;
  }

  void begin(const control::Announce& announce) {
    const bool same = announced_ && publisher_ && announced_->asset == announce.asset &&
                      announced_->format == announce.format && announced_->world == announce.world;
    announced_ = announce;
    to_remember_.clear();
    if (!same) publisher_.reset();  // Another epoch begins with the next pose.
  }

  Result<bool> go_live(Interrupt& interrupt) {
    if (!announced_) return fail(ErrorCode::kCorrupt, "the recording has poses before any announcement");
    auto encoded = objects_of(*Sha256::from_hex(announced_->asset));
    if (!encoded) return encoded.error();
    PublisherOptions options;
    options.url = command_.target.url;
    options.credentials = command_.target.credentials;
    options.key_rate_hz = announced_->key_rate_hz * command_.speed;
    options.world = announced_->world;
    StreamFormat format = announced_->format;  // Velocities of a faster motion are so much larger.
    const double velocity_us = static_cast<double>(format.velocity_us) / command_.speed;
    format.velocity_us =
        static_cast<std::uint32_t>(std::clamp(std::round(velocity_us), 1.0, double{limits::kMaxVelocityUs}));
    auto made = Publisher::create_for_keys(options, format, *std::move(encoded), to_log());
    if (const auto good = store(publisher_, std::move(made)); !good) return good.error();
    while (!wait_until_live(*publisher_, steady_now_us() + kPollUs, interrupt)) {
      if (interrupt.requested()) return false;
      if (const auto ours = check_ownership(*publisher_); !ours) return ours.error();
    }
    due_us_ = std::max(due_us_, steady_now_us());
    return true;
  }

  /// The surface as it is uploaded; only its name where it is neither here nor in --asset, but perhaps at the broker.
  Result<std::shared_ptr<const EncodedAsset>> objects_of(const Sha256& asset) {
    auto encoded = std::make_shared<EncodedAsset>();
    encoded->manifest.id = asset;
    auto whole = assemble_asset(asset, [&](const Sha256& id) {
      auto held = stream_.object(id);
      return held || command_.asset_dir.empty() ? held : read_object(command_.asset_dir, id);
    });
    if (whole) *encoded = std::move(whole->encoded);
    if (!whole && whole.error().code != ErrorCode::kNotFound) return whole.error();
    return std::shared_ptr<const EncodedAsset>(std::move(encoded));
  }

  const ReplayCommand& command_;
  RecordedStream stream_;
  std::optional<control::Announce> announced_;
  std::vector<CodedSegment> to_remember_;  ///< By the publisher, as soon as it may.
  std::unique_ptr<Publisher> publisher_;
  TimeUs due_us_ = 0;
  TimeUs capture_us_ = 0;
  std::uint64_t sent_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace

int run(const ReplayCommand& command, const Console&, Interrupt& interrupt) {
  auto stream = RecordedStream::open(command.file);
  if (!stream) return report_failure(stream.error());
  if (const ExitCode usable = check_target(command.target); usable != kExitOk) return usable;
  const recording::Info& info = stream->info();
  spdlog::info("{}: stream '{}', {:.1f} s, {} frames{}", command.file, info.start.stream,
               static_cast<double>(info.duration_us) * 1e-6, info.frames,
               info.complete ? "" : "; it was cut off, what is whole is played");
  Replayer replayer(command, *std::move(stream));
  if (auto played = replayer.run(interrupt); !played) return report_failure(played.error());
  const auto report = replayer.report();
  spdlog::info("sent {} poses, {} dropped", report["frames_sent"].get<std::uint64_t>(),
               report["frames_dropped"].get<std::uint64_t>());
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
