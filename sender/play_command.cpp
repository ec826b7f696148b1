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
                                                    std::move(baked_.encoded), command_.velocities));
        !good)
      return good;
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
        const std::lock_guard lock(mutex_);
        now_ = std::move(next_);
      }
      auto C = now_->coefficients->at(tick->frame);
      if (!C) return C.error();
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
  void end() { ends_ = true; }

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
            {"findings", findings_}};
  }

 private:
  double seconds_left(TimeUs now_us) const {
    return command_.duration_s - static_cast<double>(now_us - try_us_) * 1e-6;
  }
  /// The clip in an asset's basis.
  struct InBasis {
    std::shared_ptr<const Asset> asset;
    std::optional<Projector> projector = {};
    std::optional<ClipCoefficients> coefficients = {};
  };
  Result<std::unique_ptr<InBasis>> in_basis(std::shared_ptr<const Asset> asset, const BakeProgress& progress) const {
    auto made = std::make_unique<InBasis>(InBasis{std::move(asset)});
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
    const auto good = store(now_, in_basis(std::make_shared<const Asset>(std::move(baked_.asset)), std::ref(line)));
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
    auto asset = std::make_shared<const Asset>(whole->asset);
    // Before it is asked for. A clip that is read while it plays has one reader.
    auto next = now_->coefficients->stored()
                    ? in_basis(asset, [this](double, std::string_view) { return !ends_; })
                    : fail(ErrorCode::kTooLarge, "the clip is so long that it is read while it plays");
    if (!next) return stay_coarse(next.error());
    {
      const std::lock_guard lock(mutex_);
      next_ = std::move(*next);
    }
    go_over(*publisher_, whole);
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
  std::atomic<bool> ends_ = false;
  TimeUs try_us_ = 0;  ///< When it began to try; --duration counts from here.
  TimeUs start_us_ = 0, end_us_ = 0;
  std::uint64_t skipped_ = 0;
  std::vector<std::string> findings_;
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
