// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <vector>

#include "sender/clip_coefficients.h"
#include "sender/commands.h"
#include "sender/console.h"
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
  Player(const PlayCommand& command, const Console& console, Source source, SentRecord& record)
      : command_(command), console_(console), source_(std::move(source)), record_(record) {}

  Result<void> run(Interrupt& interrupt) {
    try_us_ = start_us_ = steady_now_us();
    asset_ = std::make_shared<const Asset>(std::move(source_.baked.asset));
    const auto projector = Projector::create(*asset_);
    if (!projector) return projector.error();

    // All frames before the first is sent, so that a bad one late in the clip is found here.
    auto coefficients = read_clip(*projector, interrupt);
    if (!coefficients) return coefficients.error();
    if (const auto good = store(publisher_, publish(command_.target, schedule_options().rate_hz, asset_,
                                                    std::move(source_.baked.encoded), command_.velocities));
        !good)
      return good;
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
      auto C = coefficients->at(tick->frame);
      if (!C) return C.error();
      if (interrupt.wait_until(tick->due_us)) break;
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
            {"findings", findings_}};
  }

 private:
  double seconds_left(TimeUs now_us) const {
    return command_.duration_s - static_cast<double>(now_us - try_us_) * 1e-6;
  }
  Result<ClipCoefficients> read_clip(const Projector& projector, Interrupt& interrupt) {
    ProgressLine line(console_.progress, stops_at(interrupt));
    auto coefficients = ClipCoefficients::create(*source_.clip, projector, std::ref(line), command_.velocities);
    line.finish();
    if (!coefficients) return coefficients;
    if (!coefficients->stored()) spdlog::warn("the clip is so long that its frames are read again while it plays");
    for (const std::string& finding : coefficients->findings()) spdlog::warn("{}", finding);
    findings_ = source_.findings;
    findings_.insert(findings_.end(), coefficients->findings().begin(), coefficients->findings().end());
    if (const auto accepted = accept_order(coefficients->order(), command_.source.any_order); !accepted)
      return in_context(command_.source.input, accepted.error());
    return coefficients;
  }

  Schedule::Options schedule_options() const {
    Schedule::Options options;
    options.clip_rate_hz = source_.clip->frame_rate_hz();
    options.rate_hz = command_.rate_hz > 0 ? command_.rate_hz : options.clip_rate_hz;
    options.speed = command_.speed;
    options.frames = source_.clip->frame_count();
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
  Source source_;
  SentRecord& record_;
  std::shared_ptr<const Asset> asset_;
  std::unique_ptr<Publisher> publisher_;
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
  auto source = bake_with_progress(command.source, console, interrupt, std::move(*opened));
  if (!source) return report_failure(source.error());
  spdlog::info("{}: {} vertices, r = {}, asset {:.12}{}", source->clip->name(), source->baked.asset.vertex_count,
               source->baked.asset.rank, source->baked.encoded.manifest.id.hex(),
               source->baked.from_cache ? ", from the cache" : "");
  Player player(command, console, std::move(*source), record);
  if (const auto played = player.run(interrupt); !played) return report_failure(played.error());
  const json report = player.report();
  spdlog::info("sent {} poses in {:.1f} s, {:.1f} kbit/s; {} dropped, {} skipped, {} reconnects",
               report["frames_sent"].get<std::uint64_t>(), report["duration_s"].get<double>(),
               report["kbit_per_s"].get<double>(), report["frames_dropped"].get<std::uint64_t>(),
               report["frames_skipped"].get<std::uint64_t>(), report["reconnects"].get<std::uint64_t>());
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
