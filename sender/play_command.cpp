// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "common/net/url.h"
#include "common/reconstruction/reconstruct.h"
#include "common/wire/control.h"
#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/schedule.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr std::size_t kMaxKeptBytes = std::size_t{64} << 20;
constexpr TimeUs kStatusEveryUs = 10'000'000;
constexpr TimeUs kConnectLookUs = 10'000;

/// Coefficients of the clip's frames: projected when first asked for and, where the whole clip is small enough, kept.
class FrameCoefficients {
 public:
  FrameCoefficients(const MotionClip& clip, const Projector& projector, std::size_t values_per_frame)
      : clip_(clip),
        projector_(projector),
        keep_(clip.frame_count() * values_per_frame * sizeof(double) <= kMaxKeptBytes) {
    kept_.resize(keep_ ? clip.frame_count() : 1);
  }

  /// Projects what is kept: playing then costs next to nothing.
  Result<void> project_ahead(Interrupt& interrupt) {
    for (std::size_t frame = 0; keep_ && frame < kept_.size() && !interrupt.requested(); ++frame)
      if (auto C = at(frame); !C) return C.error();
    return {};
  }

  Result<std::vector<double>> at(std::size_t frame) {
    std::vector<double>& kept = kept_[keep_ ? frame : 0];
    if (keep_ && !kept.empty()) return kept;
    const auto positions = clip_.pose(frame);
    if (!positions) return positions.error();
    flat_.clear();
    for (const Vec3& vertex : *positions) flat_.insert(flat_.end(), vertex.begin(), vertex.end());
    auto C = projector_.coefficients_from_positions(std::span<const double>(flat_));
    if (!C) return in_context("frame " + std::to_string(frame), C.error());
    if (keep_) kept = *C;
    return C;
  }

 private:
  const MotionClip& clip_;
  const Projector& projector_;
  bool keep_;
  std::vector<std::vector<double>> kept_;
  std::vector<double> flat_;
};

std::string_view name_of(SendStatus status) {
  switch (status) {
    case SendStatus::kSent:
      return "sent";
    case SendStatus::kDropped:
      return "dropped";
    case SendStatus::kDisconnected:
      return "disconnected";
  }
  return "unknown";
}

/// The record of what was sent when, for whoever compares it with what arrived.
class SentRecord {
 public:
  Result<void> open(const std::string& path) {
    if (path.empty()) return {};
    out_.open(path, std::ios::trunc);
    if (!out_) return fail(ErrorCode::kIo, path + ": cannot be written; is the folder there and writable?");
    return {};
  }
  void add(const Schedule::Tick& tick, SendStatus status) {
    if (out_.is_open()) {
      out_ << json{{"capture_us", tick.due_us}, {"frame", tick.frame}, {"status", name_of(status)}}.dump() << std::endl;
    }
  }

 private:
  std::ofstream out_;
};

/// One run of the play loop and what it counted.
class Player {
 public:
  Player(const PlayCommand& command, Source source) : command_(command), source_(std::move(source)) {}

  Result<void> run(Interrupt& interrupt);
  json report() const;

 private:
  Result<void> connect();
  /// Waits until the broker takes poses, so that a clip that is played once is played whole; false if interrupted
  /// before. Errors: kUnreachable (the time that was given to play is over).
  Result<bool> wait_until_live(Interrupt& interrupt) const;
  /// Seconds of --duration that are left at `now_us`.
  double seconds_left(TimeUs now_us) const {
    return command_.duration_s - static_cast<double>(now_us - try_us_) * 1e-6;
  }
  Schedule::Options schedule_options() const;
  void log_status(TimeUs now_us);

  const PlayCommand& command_;
  Source source_;
  std::shared_ptr<const Asset> asset_;
  std::unique_ptr<Publisher> publisher_;
  Publisher::Stats last_;
  TimeUs try_us_ = 0;  ///< When it began to try; --duration counts from here.
  TimeUs start_us_ = 0, end_us_ = 0, status_us_ = 0;
  std::uint64_t skipped_ = 0;
};

Result<void> Player::connect() {
  const auto codec = codec_from_name(command_.codec);
  if (!codec) return codec.error();
  PublisherOptions options;
  options.url = command_.url;
  options.codec = *codec;
  options.error = command_.error;
  options.key_rate_hz = schedule_options().rate_hz;
  auto publisher =
      Publisher::create(options, asset_, std::make_shared<const EncodedAsset>(std::move(source_.baked.encoded)),
                        [](LogLevel level, std::string_view text) {
                          spdlog::log(level == LogLevel::kError     ? spdlog::level::err
                                      : level == LogLevel::kWarning ? spdlog::level::warn
                                      : level == LogLevel::kInfo    ? spdlog::level::info
                                                                    : spdlog::level::debug,
                                      "{}", text);
                        });
  if (!publisher) return publisher.error();
  publisher_ = std::move(*publisher);
  return {};
}

Result<bool> Player::wait_until_live(Interrupt& interrupt) const {
  while (publisher_->stats().state != Publisher::State::kLive) {
    if (command_.duration_s > 0 && seconds_left(steady_now_us()) <= 0)
      return fail(ErrorCode::kUnreachable,
                  "no pose was sent: the duration is over and the broker is not live: " + publisher_->stats().detail);
    if (interrupt.wait_until(steady_now_us() + kConnectLookUs)) return false;
  }
  return true;
}

Schedule::Options Player::schedule_options() const {
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

void Player::log_status(TimeUs now_us) {
  if (now_us - status_us_ < kStatusEveryUs) return;
  const Publisher::Stats now = publisher_->stats();
  const double seconds = static_cast<double>(now_us - status_us_) * 1e-6;
  spdlog::info("{:.1f} poses/s, {:.1f} kbit/s, {} viewers, {} dropped",
               static_cast<double>(now.frames_sent - last_.frames_sent) / seconds,
               static_cast<double>(now.payload_bytes - last_.payload_bytes) * 8e-3 / seconds, now.subscribers,
               now.frames_dropped - last_.frames_dropped);
  last_ = now;
  status_us_ = now_us;
}

Result<void> Player::run(Interrupt& interrupt) {
  SentRecord record;
  if (const auto opened = record.open(command_.record); !opened) return opened;
  try_us_ = start_us_ = steady_now_us();
  asset_ = std::make_shared<const Asset>(std::move(source_.baked.asset));
  const auto projector = Projector::create(*asset_);
  if (!projector) return projector.error();
  FrameCoefficients coefficients(*source_.clip, *projector, std::size_t{asset_->rank} * 3);

  // Before anybody sees the first frame, so that a bad one late in the clip is found here.
  if (auto kept = coefficients.project_ahead(interrupt); !kept) return kept;
  if (const auto connected = connect(); !connected) return connected;
  start_us_ = end_us_ = steady_now_us();
  const auto live = wait_until_live(interrupt);
  if (!live) return live.error();
  if (!*live) return {};
  start_us_ = status_us_ = steady_now_us();
  Schedule schedule(schedule_options(), start_us_);
  while (const auto tick = schedule.next(steady_now_us())) {
    const auto C = coefficients.at(tick->frame);
    if (!C) return C.error();
    if (interrupt.wait_until(tick->due_us)) break;
    record.add(*tick, publisher_->send_coefficients(*C, tick->due_us));
    log_status(steady_now_us());
  }
  end_us_ = steady_now_us();
  skipped_ = schedule.skipped();
  return {};
}

json Player::report() const {
  const Publisher::Stats stats = publisher_->stats();
  const double seconds = static_cast<double>(end_us_ - start_us_) * 1e-6;
  return {{"frames_sent", stats.frames_sent},
          {"frames_dropped", stats.frames_dropped},
          {"frames_skipped", skipped_},
          {"bytes", stats.payload_bytes},
          {"kbit_per_s", seconds > 0 ? static_cast<double>(stats.payload_bytes) * 8e-3 / seconds : 0.0},
          {"duration_s", seconds},
          {"reconnects", stats.reconnects}};
}

Result<void> check_stream_url(const std::string& text) {
  const auto url = parse_broker_url(text);
  if (!url) return url.error();
  if (auto name = check_stream_name(url->stream); !name)
    return in_context("stream name in \"" + text + "\"", name.error());
  return {};
}

}  // namespace

int run(const PlayCommand& command, const Console& console, Interrupt& interrupt) {
  // Before the bake, which may take minutes.
  if (const auto usable = check_stream_url(command.url); !usable) {
    spdlog::error("{}", usable.error().message);
    return kExitUsage;
  }
  auto source = bake_with_progress(command.source, console, interrupt);
  if (!source) return report_failure(source.error());
  spdlog::info("{}: {} vertices, r = {}, asset {:.12}{}", source->clip->name(), source->baked.asset.vertex_count,
               source->baked.asset.rank, source->baked.encoded.manifest.id.hex(),
               source->baked.from_cache ? ", from the cache" : "");
  Player player(command, std::move(*source));
  if (const auto played = player.run(interrupt); !played) return report_failure(played.error());
  const json report = player.report();
  spdlog::info("sent {} poses in {:.1f} s, {:.1f} kbit/s; {} dropped, {} skipped, {} reconnects",
               report["frames_sent"].get<std::uint64_t>(), report["duration_s"].get<double>(),
               report["kbit_per_s"].get<double>(), report["frames_dropped"].get<std::uint64_t>(),
               report["frames_skipped"].get<std::uint64_t>(), report["reconnects"].get<std::uint64_t>());
  const auto written = write_report(command.json, report.dump(2));
  return written ? kExitOk : report_failure(written.error());
}

}  // namespace eigencast
