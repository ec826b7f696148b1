// SPDX-License-Identifier: MIT
#include "sender/live.h"

#include <spdlog/spdlog.h>

#include "common/command_line/log.h"
#include "common/net/http.h"
#include "common/wire/link_bytes.h"
#include "sdk/broker.h"
#include "sdk/publisher.h"

namespace eigencast {
namespace {

constexpr TimeUs kStatusEveryUs = 10'000'000;
constexpr TimeUs kConnectPollUs = 10'000;
constexpr std::chrono::seconds kProbeTimeout{3};

Result<PublisherOptions> options_of(const TargetOptions& target, bool velocities) {
  const auto codec = codec_from_name(target.codec);
  if (!codec) return codec.error();
  PublisherOptions options;
  options.url = target.url;
  options.credentials = target.credentials;
  options.codec = *codec;
  options.error = target.error;
  options.bitrate = target.bitrate_kbit * 1000;
  options.still_heartbeat_us = static_cast<TimeUs>(target.still_s * 1e6);
  options.memory = target.memory;
  options.velocities = velocities;
  return options;
}

Result<BrokerUrl> destination_of(const TargetOptions& target, bool velocities) {
  const auto options = options_of(target, velocities);
  if (!options) return options.error();
  if (const auto usable = check_options(*options); !usable) return usable.error();
  return stream_url(options->url, options->credentials, {});
}

}  // namespace

LogSink to_log() {
  return sink_to(spdlog::default_logger());
}

Result<std::unique_ptr<Publisher>> publish(const TargetOptions& target, double rate_hz,
                                           std::shared_ptr<const Asset> asset,
                                           std::shared_ptr<const EncodedAsset> encoded, bool velocities) {
  auto options = options_of(target, velocities);
  if (!options) return options.error();
  options->key_rate_hz = rate_hz;
  return Publisher::create(*options, std::move(asset), std::move(encoded), to_log());
}

void log_bake(const BakeResult& baked) {
  if (const auto& trial = baked.trial)
    spdlog::log(trial->is_met() ? spdlog::level::info : spdlog::level::warn, "{}", text_of(*trial));
  if (!baked.not_kept.empty()) spdlog::warn("the bake is not kept: {}", baked.not_kept);
}

void log_clip(const MotionClip& clip) {
  for (const std::string& note : clip.notes()) spdlog::info("{}", note);
  if (clip.appearance() == nullptr) return;
  for (const std::string& what : clip.appearance()->missing) spdlog::warn("{}", what);
}

void stay_coarse(const Error& why) {
  if (why.code != ErrorCode::kCancelled) spdlog::error("the stream stays coarse: {}", why.message);
}

void go_over(Publisher& publisher, const BakeResult& whole, std::shared_ptr<const Asset> asset,
             std::shared_ptr<const EncodedAsset> encoded) {
  log_bake(whole);
  spdlog::info("all of the basis is there: r = {}, asset {:.12}", asset->rank, encoded->manifest.id.hex());
  const auto changes = publisher.change_to(std::move(asset), std::move(encoded));
  if (!changes) stay_coarse(changes.error());
}

bool wait_until_live(const Publisher& publisher, TimeUs deadline_us, Interrupt& interrupt) {
  while (publisher.stats().state != Publisher::State::kLive) {
    if (!check_ownership(publisher)) return false;
    const TimeUs now_us = steady_now_us();
    if ((deadline_us > 0 && now_us >= deadline_us) || interrupt.wait_until(now_us + kConnectPollUs)) return false;
  }
  return true;
}

Result<void> check_ownership(const Publisher& publisher) {
  const Publisher::Stats stats = publisher.stats();
  return stats.gave_up ? fail(ErrorCode::kRefused, stats.detail) : Result<void>();
}

ExitCode check_target(const TargetOptions& target, bool velocities) {
  const auto url = destination_of(target, velocities);
  if (!url) {
    spdlog::error("{}", url.error().message);
    return kExitUsage;
  }
  auto let_in = probe(*url, "/v1/publish/" + url->stream, kProbeTimeout);
  if (!let_in) {
    const auto found = located(*url);
    if (found && probe(*found, "/v1/publish/" + found->stream, kProbeTimeout)) let_in = Result<void>();
  }
  if (let_in) {
    spdlog::info("to {}", url->shown());
    return kExitOk;
  }
  if (let_in.error().code == ErrorCode::kRefused) {
    spdlog::error("{}", let_in.error().message);
    return kExitUnreachable;
  }
  spdlog::warn("{}; it is tried again when there is something to send", let_in.error().message);
  return kExitOk;
}

void StatusLog::show(const Publisher& publisher, TimeUs now_us) {
  if (now_us - shown_us_ < kStatusEveryUs) return;
  const Publisher::Stats now = publisher.stats();
  const double seconds = static_cast<double>(now_us - shown_us_) * 1e-6;
  const auto kbit_per_s = [&](std::uint64_t bytes) { return static_cast<double>(bytes) * 8e-3 / seconds; };
  // May be less than nothing: where a key that was predicted from the memory took more than a plain one.
  const double saved = static_cast<double>(now.saved_bytes) - static_cast<double>(last_.saved_bytes);
  std::string memory;
  if (now.memory_bytes > 0)
    memory = fmt::format(" (of memory {:.1f}, which saves {:.1f})", kbit_per_s(now.memory_bytes - last_.memory_bytes),
                         saved * 8e-3 / seconds);
  const auto frames = static_cast<double>(now.frames_sent - last_.frames_sent);
  const std::uint64_t bytes = now.payload_bytes - last_.payload_bytes;
  const LinkBytes more = link_bytes(frames, static_cast<double>(bytes));
  spdlog::info("{:.1f} poses/s, {:.1f} kbit/s{}, on a viewer's link {:.1f} more (TLS {:.1f}), {} viewers, {} dropped",
               frames / seconds, kbit_per_s(bytes), memory, (more.websocket + more.tcp_ip) * 8e-3 / seconds,
               more.total() * 8e-3 / seconds, now.subscribers, now.frames_dropped - last_.frames_dropped);
  last_ = now;
  shown_us_ = now_us;
}

}  // namespace eigencast
