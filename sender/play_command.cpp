// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <functional>
#include <mutex>
#include <nlohmann/json.hpp>
#include <vector>

#include "sdk/pose_projection.h"
#include "sdk/stream_learner.h"
#include "sender/clip_coefficients.h"
#include "sender/commands.h"
#include "sender/console.h"
#include "sender/growing_bake.h"
#include "sender/live.h"
#include "sender/order_check.h"
#include "sender/pose_stream.h"

namespace eigencast {
namespace {

using nlohmann::json;

/// For tools/compare.
class SentRecord {
 public:
  Result<void> open(const std::string& path) {
    if (path.empty()) return {};
    out_.open(path, std::ios::trunc);
    if (!out_) return fail(ErrorCode::kIo, path + ": cannot be written; is the folder there and writable?");
    return {};
  }
  void add(const Schedule::Tick& tick, SendStatus status) {
    constexpr const char* kNames[] = {"sent", "dropped", "disconnected"};
    if (!out_.is_open()) return;
    out_
        << json{{"capture_us", tick.due_us}, {"frame", tick.frame}, {"status", kNames[static_cast<int>(status)]}}.dump()
        << std::endl;
  }

 private:
  std::ofstream out_;
};

class Player {
 public:
  Player(const PlayCommand& command, const Console& console, GrowingBake& bake, BakeResult baked, SentRecord& record)
      : command_(command), console_(console), bake_(bake), baked_(std::move(baked)), record_(record) {}

  Result<void> run(Interrupt& interrupt) {
    try_us_ = start_us_ = steady_now_us();
    // All frames before the first is sent, so that a bad one late in the clip is found here.
    if (const auto good = begin_clip(interrupt); !good) return good;
    if (const auto good = store(publisher_, publish(command_.target, schedule_options().rate_hz, now_->asset,
                                                    now_->encoded, command_.velocities));
        !good)
      return good;
    begin_learning();
    if (!bake_.is_whole()) {
      bake_.then([this](Result<BakeResult>& whole) { take_whole(whole); },
                 [this](double fraction) { publisher_->show_progress(fraction); });
    }
    start_us_ = end_us_ = steady_now_us();
    // So that a clip that is played once is played whole.
    const TimeUs deadline_us = command_.duration_s > 0 ? try_us_ + static_cast<TimeUs>(command_.duration_s * 1e6) : 0;
    if (!wait_until_live(*publisher_, deadline_us, interrupt)) {
      if (interrupt.requested()) return {};
      if (const auto ours = check_ownership(*publisher_); !ours) return ours;
      return fail(ErrorCode::kUnreachable,
                  "no pose was sent: the duration is over and the broker is not live: " + publisher_->stats().detail);
    }
    start_us_ = steady_now_us();
    StatusLog status(start_us_);
    Schedule schedule(schedule_options(), start_us_);
    while (const auto tick = schedule.next(steady_now_us())) {
      if (interrupt.wait_until(tick->due_us)) break;
      if (publisher_->take_change()) {
        {
          const std::lock_guard lock(mutex_);
          now_ = std::move(next_);
        }
        begin_learning();
      }
      auto C = now_->coefficients->at(tick->frame);
      if (!C) return C.error();
      if (const auto learnt = learn_from(*tick, *C); !learnt) return learnt;
      if (const auto ours = check_ownership(*publisher_); !ours) return ours;
      record_.add(*tick, send(*C, tick->due_us));
      status.show(*publisher_, steady_now_us());
    }
    end_us_ = steady_now_us();
    skipped_ = schedule.skipped();
    const Publisher::Stats stats = publisher_->stats();
    if (stats.frames_sent == 0 && stats.frames_dropped > 0 && !interrupt.requested())
      return fail(stats.state == Publisher::State::kLive ? ErrorCode::kInvalidArgument : ErrorCode::kUnreachable,
                  "no pose was sent: " + stats.detail);
    return {};
  }

  /// Of the work for a basis that nothing will be sent in.
  void end() {
    ends_ = true;
    learner_.reset();
  }

  json report() const {
    const Publisher::Stats stats = publisher_->stats();
    const double seconds = static_cast<double>(end_us_ - start_us_) * 1e-6;
    return {{"frames_sent", stats.frames_sent},
            {"frames_dropped", stats.frames_dropped},
            {"frames_held", stats.frames_held},
            {"frames_skipped", skipped_},
            {"bytes", stats.payload_bytes},
            {"frames_recalled", stats.frames_recalled},
            {"memory_bytes", stats.memory_bytes},
            {"saved_bytes", stats.saved_bytes},
            {"kbit_per_s", seconds > 0 ? static_cast<double>(stats.payload_bytes) * 8e-3 / seconds : 0.0},
            {"duration_s", seconds},
            {"reconnects", stats.reconnects},
            {"changes", stats.changes},
            {"learnt_columns", stats.learnt_columns},
            {"learnt_bytes", stats.learnt_bytes},
            {"findings", findings_}};
  }

 private:
  double seconds_left(TimeUs now_us) const {
    return command_.duration_s - static_cast<double>(now_us - try_us_) * 1e-6;
  }
  /// The clip in an asset's basis.
  struct InBasis {
    std::shared_ptr<const Asset> asset;
    std::shared_ptr<const EncodedAsset> encoded;
    std::optional<Projector> projector = {};
    std::optional<ClipCoefficients> coefficients = {};
  };
  Result<std::unique_ptr<InBasis>> in_basis(std::shared_ptr<const Asset> asset,
                                            std::shared_ptr<const EncodedAsset> encoded,
                                            const BakeProgress& progress) const {
    auto made = std::make_unique<InBasis>(InBasis{std::move(asset), std::move(encoded)});
    auto projector = Projector::create(*made->asset);
    if (!projector) return projector.error();
    made->projector = std::move(*projector);
    auto coefficients = ClipCoefficients::create(bake_.clip(), *made->projector, progress, command_.velocities);
    if (!coefficients) return coefficients.error();
    made->coefficients = std::move(*coefficients);
    return made;
  }

  Result<void> begin_clip(Interrupt& interrupt) {
    ProgressLine line(console_.progress, stops_at(interrupt));
    const auto good =
        store(now_, in_basis(std::make_shared<const Asset>(std::move(baked_.asset)),
                             std::make_shared<const EncodedAsset>(std::move(baked_.encoded)), std::ref(line)));
    is_whole_ = bake_.is_whole();
    line.finish();
    if (!good) return good;
    const ClipCoefficients& coefficients = *now_->coefficients;
    if (!coefficients.stored()) spdlog::warn("the clip is so long that its frames are read again while it plays");
    for (const std::string& finding : coefficients.findings()) spdlog::warn("{}", finding);
    findings_ = bake_.findings();
    findings_.insert(findings_.end(), coefficients.findings().begin(), coefficients.findings().end());
    const auto accepted = accept_order(coefficients.order(), command_.source.any_order);
    return accepted ? accepted : in_context(command_.source.input, accepted.error());
  }

  /// On the bake's thread.
  void take_whole(Result<BakeResult>& whole) {
    if (!whole) return stay_coarse(whole.error());
    const auto asset = std::make_shared<const Asset>(std::move(whole->asset));
    const auto encoded = std::make_shared<const EncodedAsset>(std::move(whole->encoded));
    if (const auto good = make_next(asset, encoded); !good) return stay_coarse(good.error());
    is_whole_ = true;
    go_over(*publisher_, *whole, asset, encoded);
  }
  /// The clip as it is to be sent in an asset that the stream will be asked to go over to.
  Result<void> make_next(const std::shared_ptr<const Asset>& asset,
                         const std::shared_ptr<const EncodedAsset>& encoded) {
    if (!now_->coefficients->stored())  // It has one reader.
      return fail(ErrorCode::kTooLarge, "the clip is so long that it is read while it plays");
    auto next = in_basis(asset, encoded, [this](double, std::string_view) { return !ends_; });
    if (!next) return next.error();
    const std::lock_guard lock(mutex_);
    next_ = std::move(*next);
    return {};
  }

  /// From the basis that is now in use, if it is the whole one as it was baked.
  void begin_learning() {
    const bool is_learnt = !now_->encoded->sections.empty();
    if (command_.target.learn == LearnUse::kOff || !is_whole_ || is_learnt || command_.target.codec != "quantised" ||
        !now_->coefficients->stored())
      return learner_.reset();
    learner_ = std::make_unique<StreamLearner>(
        command_.target.learn, [this](const auto&, const LearntAsset& learnt) { take_learnt(learnt); }, to_log());
    PublisherOptions options;
    options.error = command_.target.error;
    learner_->begin(now_->asset, now_->encoded, error_bound(options, *now_->asset));
  }
  /// C: as of ClipCoefficients::at.
  Result<void> learn_from(const Schedule::Tick& tick, std::span<const double> C) {
    if (!learner_ || !learner_->wants(tick.due_us)) return {};
    const std::unique_lock lock(clip_, std::try_to_lock);
    if (!lock) return {};
    const auto pose = bake_.clip().pose(tick.frame);
    if (!pose) return pose.error();
    std::vector<float> positions;
    positions.reserve(3 * pose->size());
    for (const Vec3& p : *pose) positions.insert(positions.end(), p.begin(), p.end());
    learner_->add(positions, C.first(std::size_t{3} * now_->asset->rank), tick.due_us);
    return {};
  }
  /// On the learner's thread.
  void take_learnt(const LearntAsset& learnt) {
    const std::lock_guard lock(clip_);
    auto changes = make_next(learnt.asset, learnt.encoded);
    if (changes) changes = publisher_->change_to(learnt.asset, learnt.encoded, learnt.coarser);
    if (!changes && changes.error().code != ErrorCode::kCancelled)
      spdlog::error("what was learnt is not used: {}", changes.error().message);
  }

  Schedule::Options schedule_options() const {
    Schedule::Options options;
    options.clip_rate_hz = bake_.clip().frame_rate_hz();
    options.rate_hz = command_.rate_hz > 0 ? command_.rate_hz : options.clip_rate_hz;
    options.speed = command_.speed;
    options.frames = bake_.clip().frame_count();
    options.loop = !command_.once;
    options.max_ticks = command_.frames;
    if (command_.duration_s > 0) {
      const double seconds = std::max(0.0, seconds_left(start_us_));
      const auto ticks = static_cast<std::uint64_t>(std::max(1.0, std::ceil(seconds * options.rate_hz)));
      options.max_ticks = options.max_ticks > 0 ? std::min(options.max_ticks, ticks) : ticks;
    }
    return options;
  }

  SendStatus send(std::vector<double>& values, TimeUs due_us) {
    if (!command_.velocities) return publisher_->send_coefficients(values, due_us);
    const std::span<double> all(values), V = all.subspan(values.size() / 2);
    for (double& v : V) v *= command_.speed;  // From the clip's seconds to the viewer's.
    return publisher_->send_coefficients(all.first(values.size() / 2), due_us, V);
  }

  const PlayCommand& command_;
  const Console& console_;
  GrowingBake& bake_;
  BakeResult baked_;  ///< Until it is published.
  SentRecord& record_;
  std::unique_ptr<InBasis> now_;
  std::unique_ptr<Publisher> publisher_;
  std::mutex mutex_;
  std::unique_ptr<InBasis> next_;  ///< GUARDED_BY(mutex_) What the publisher goes over to.
  std::atomic<bool> ends_ = false, is_whole_ = false;
  std::mutex clip_;    ///< Held while it is read beside the stream.
  TimeUs try_us_ = 0;  ///< When it began to try; --duration counts from here.
  TimeUs start_us_ = 0, end_us_ = 0;
  std::uint64_t skipped_ = 0;
  std::vector<std::string> findings_;
  std::unique_ptr<StreamLearner> learner_;  ///< Last: its thread uses all above. Null: nothing is learnt.
};

/// Before the bake, which may take minutes.
Result<OpenedSource> prepare(const PlayCommand& command, SentRecord& record) {
  if (const auto opened = record.open(command.record); !opened) return opened.error();
  auto clip = open_source(command.source);
  if (!clip) return clip.error();
  if (command.velocities && !(*clip)->has_velocities()) return (*clip)->velocity(0).error();
  return OpenedSource{std::move(*clip)};
}

}  // namespace

int run(const PlayCommand& command, const Console& console, Interrupt& interrupt) {
  if (const ExitCode usable = check_target(command.target, command.velocities); usable != kExitOk) return usable;
  SentRecord record;
  auto opened = prepare(command, record);
  if (!opened) return report_failure(opened.error());
  std::optional<Player> player;
  GrowingBake bake(command.source, std::move(*opened));  // Ends first: its thread uses the player.
  auto baked = bake.first(console, interrupt);
  if (!baked) return report_failure(baked.error());
  player.emplace(command, console, bake, std::move(*baked), record);
  const auto played = player->run(interrupt);
  player->end();
  if (!played) return report_failure(played.error());
  const json report = player->report();
  spdlog::info("sent {} poses in {:.1f} s, {:.1f} kbit/s; {} dropped, {} skipped, {} reconnects",
               report["frames_sent"].get<std::uint64_t>(), report["duration_s"].get<double>(),
               report["kbit_per_s"].get<double>(), report["frames_dropped"].get<std::uint64_t>(),
               report["frames_skipped"].get<std::uint64_t>(), report["reconnects"].get<std::uint64_t>());
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
