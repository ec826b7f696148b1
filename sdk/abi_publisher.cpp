// SPDX-License-Identifier: MIT
#include <algorithm>
#include <chrono>
#include <span>
#include <string>
#include <thread>

#include "common/core/clock.h"
#include "sdk/abi.h"
#include "sdk/publisher.h"

struct ec_publisher {
  std::unique_ptr<eigencast::Publisher> publisher;
  std::size_t vertices = 0, scalars = 0;
  mutable std::string detail = {};  ///< Of the last statistics.
  eigencast::abi::OfProcess home = {};
};

namespace eigencast {
namespace {

constexpr std::chrono::milliseconds kLivePoll{5};

ec_status from_send(const Result<SendStatus>& sent) {
  if (!sent) return abi::failed(sent.error());
  return *sent == SendStatus::kSent ? EC_OK : *sent == SendStatus::kDropped ? EC_DROPPED : EC_DISCONNECTED;
}

/// A caller's array of so many values for each vertex, where the publisher was made for it.
std::span<const float> rows_of(const float* values, std::size_t vertices, std::size_t width) {
  return values == nullptr ? std::span<const float>() : std::span(values, vertices * width);
}

}  // namespace

Result<PublisherOptions> abi::publisher_options_from(const ec_publisher_options& given) {
  PublisherOptions options;
  options.credentials = credentials_from(given);
  const auto codec = codec_from_name(text_or(given.codec, "quantised"));
  if (!codec) return codec.error();
  options.codec = *codec;
  options.error = given.error;
  options.bitrate = given.bitrate;
  options.still_heartbeat_us = given.still_heartbeat_us;
  if (given.key_rate_hz > 0) options.key_rate_hz = given.key_rate_hz;
  for (std::uint32_t k = 0; k < std::min(given.scalars, kMaxScalars + 1); ++k) {
    const ec_scalar s = given.scalar_info != nullptr ? given.scalar_info[k] : ec_scalar{};
    options.scalars.push_back(
        {text_or(s.name, "scalar-" + std::to_string(k + 1)), text_or(s.unit, ""), s.low, s.high, s.error});
  }
  options.velocities = given.velocities != 0;
  const auto memory = kMemoryUseNames.find(text_or(given.memory, "auto"));
  if (!memory) return fail(ErrorCode::kInvalidArgument, "memory must be auto, on or off");
  options.memory = *memory;
  const auto learn = kLearnUseNames.find(text_or(given.learn, "off"));
  if (!learn) return fail(ErrorCode::kInvalidArgument, "learn must be auto, on or off");
  options.learn = *learn;
  return options;
}

}  // namespace eigencast

using namespace eigencast;
using namespace eigencast::abi;

ec_status ec_publisher_create(const char* url, const ec_asset* asset, const ec_publisher_options* options,
                              ec_publisher** publisher) {
  return guarded([&] {
    if (url == nullptr || asset == nullptr || publisher == nullptr)
      return invalid("ec_publisher_create: url, asset or publisher is null");
    if (lacks_size(options)) return invalid("ec_publisher_create: struct_size of the options is not set; use EC_INIT");
    const ec_publisher_options given = filled(options);
    auto publisher_options = publisher_options_from(given);
    if (!publisher_options) return failed(publisher_options.error());
    publisher_options->url = url;
    auto created = Publisher::create(*publisher_options, asset->asset, asset->encoded);
    if (!created) return failed(created.error());
    *publisher = new ec_publisher{std::move(*created), asset->asset->vertex_count, given.scalars};
    return EC_OK;
  });
}

ec_status ec_publisher_send(ec_publisher* publisher, const float* positions, int64_t capture_us) {
  return guarded([&] {
    if (publisher == nullptr || positions == nullptr)
      return invalid("ec_publisher_send: publisher or positions is null");
    const auto sent = publisher->publisher->send_positions({positions, 3 * publisher->vertices}, capture_us);
    return from_send(sent);
  });
}

ec_status ec_publisher_send_pose(ec_publisher* publisher, const ec_pose* pose) {
  return guarded([&] {
    if (publisher == nullptr || pose == nullptr) return invalid("ec_publisher_send_pose: publisher or pose is null");
    if (lacks_size(pose)) return invalid("ec_publisher_send_pose: struct_size of the pose is not set; use EC_INIT");
    const ec_pose given = filled(pose);
    if (given.positions == nullptr) return invalid("ec_publisher_send_pose: positions are null");
    const std::size_t n = publisher->vertices;
    const auto sent = publisher->publisher->send_pose({rows_of(given.positions, n, 3), rows_of(given.velocities, n, 3),
                                                       rows_of(given.scalars, n, publisher->scalars)},
                                                      given.capture_us);
    return from_send(sent);
  });
}

ec_status ec_publisher_get_stats(const ec_publisher* publisher, ec_publisher_stats* stats) {
  return guarded([&] {
    if (publisher == nullptr) return invalid("ec_publisher_get_stats: publisher is null");
    const Publisher::Stats now = publisher->publisher->stats();
    ec_publisher_stats result = EC_INIT(ec_publisher_stats);
    result.live = now.state == Publisher::State::kLive ? 1 : 0;
    result.subscribers = now.subscribers;
    result.frames_sent = now.frames_sent;
    result.frames_dropped = now.frames_dropped;
    result.bytes_sent = now.payload_bytes;
    result.reconnects = now.reconnects;
    const auto dropped = [&now](Publisher::DropReason why) { return now.dropped_for[static_cast<std::size_t>(why)]; };
    result.dropped_disconnected = dropped(Publisher::DropReason::kDisconnected);
    result.dropped_behind = dropped(Publisher::DropReason::kBehind);
    result.dropped_time = dropped(Publisher::DropReason::kTime);
    result.dropped_unusable = dropped(Publisher::DropReason::kUnusable);
    result.detail = (publisher->detail = now.detail).c_str();
    return give(stats, result);
  });
}

ec_status ec_publisher_wait_live(const ec_publisher* publisher, int timeout_ms) {
  return guarded([&] {
    if (publisher == nullptr) return invalid("ec_publisher_wait_live: publisher is null");
    const TimeUs end = steady_now_us() + TimeUs{1000} * std::max(0, timeout_ms);
    while (true) {
      const Publisher::Stats now = publisher->publisher->stats();
      if (now.state == Publisher::State::kLive) return EC_OK;
      if (now.gave_up) return failed(fail(ErrorCode::kRefused, now.detail));
      if (steady_now_us() >= end) return EC_NOTHING;
      std::this_thread::sleep_for(kLivePoll);
    }
  });
}

void ec_publisher_release(ec_publisher* publisher) {
  release_at_home(publisher);
}
