// SPDX-License-Identifier: MIT
#include <chrono>
#include <memory>
#include <string>

#include "sdk/abi.h"
#include "sdk/asset_cache.h"
#include "sdk/surface_stream.h"

struct ec_stream {
  std::unique_ptr<eigencast::SurfaceStream> stream;
  std::size_t scalars = 0;
  mutable std::string detail = {};  ///< Of the last statistics.
};

using namespace eigencast;
using namespace eigencast::abi;

namespace {

Result<SurfaceStreamOptions> stream_options_from(const char* url, const ec_stream_options& given) {
  if (lacks_size(given.bake) || lacks_size(given.publisher))
    return fail(ErrorCode::kInvalidArgument,
                "struct_size of the bake's or publisher's options is not set; use EC_INIT");
  const ec_bake_options bake = filled(given.bake);
  if (bake.appearance != nullptr || bake.poses != nullptr || bake.columns != nullptr || bake.progress != nullptr)
    return fail(ErrorCode::kInvalidArgument,
                "a stream bakes later, in a thread: appearance, poses, columns and progress are for ec_bake() and a "
                "publisher");
  SurfaceStreamOptions options;
  const auto baking = bake_options_from(bake);
  if (!baking) return baking.error();
  options.bake = *baking;
  const auto publishing = publisher_options_from(filled(given.publisher));
  if (!publishing) return publishing.error();
  options.publisher = *publishing;
  options.publisher.url = url;
  options.cache_dir = bake.cache_dir != nullptr ? bake.cache_dir : default_cache_dir();
  const std::string up = text_or(given.up, "y");
  if (up != "y" && up != "z") return fail(ErrorCode::kInvalidArgument, "up must be y or z");
  options.z_up = up == "z";
  if (given.scale != 0) options.scale = given.scale;
  if (given.max_rate_hz != 0) options.max_rate_hz = given.max_rate_hz;
  options.rebake = given.refuse_topology == 0;
  return options;
}

/// Null is none.
template <typename T>
std::span<const T> values_of(const T* values, std::size_t count) {
  return values == nullptr ? std::span<const T>() : std::span(values, count);
}

}  // namespace

ec_status ec_stream_create(const char* url, const ec_stream_options* options, ec_stream** stream) {
  return guarded([&] {
    if (url == nullptr || stream == nullptr) return invalid("ec_stream_create: url or stream is null");
    if (lacks_size(options)) return invalid("ec_stream_create: struct_size of the options is not set; use EC_INIT");
    auto stream_options = stream_options_from(url, filled(options));
    if (!stream_options) return failed(stream_options.error());
    const std::size_t scalars = stream_options->publisher.scalars.size();
    auto made = SurfaceStream::create(std::move(*stream_options));
    if (!made) return failed(made.error());
    *stream = new ec_stream{std::move(*made), scalars};
    return EC_OK;
  });
}

ec_status ec_stream_send(ec_stream* stream, const ec_frame* frame) {
  return guarded([&] {
    if (stream == nullptr || frame == nullptr) return invalid("ec_stream_send: stream or frame is null");
    if (lacks_size(frame)) return invalid("ec_stream_send: struct_size of the frame is not set; use EC_INIT");
    const ec_frame given = filled(frame);
    const std::size_t n = given.point_count;
    SurfaceStream::Frame to_send;
    to_send.points = values_of(given.points, 3 * n);
    to_send.corners = values_of(given.corners, given.corner_count);
    to_send.offsets = values_of(given.offsets, given.offset_count);
    to_send.as_before = given.corners == nullptr;
    to_send.scalars = values_of(given.scalars, stream->scalars * n);
    to_send.velocities = values_of(given.velocities, 3 * n);
    if (given.time_s != nullptr) to_send.time_s = *given.time_s;
    const auto sent = stream->stream->send(to_send);
    if (!sent) return failed(sent.error());
    return *sent == SurfaceStream::Sent::kTaken    ? EC_OK
           : *sent == SurfaceStream::Sent::kBaking ? EC_BAKING
                                                   : EC_DISCONNECTED;
  });
}

ec_status ec_stream_wait_live(ec_stream* stream, int timeout_ms) {
  return guarded([&] {
    if (stream == nullptr) return invalid("ec_stream_wait_live: stream is null");
    const auto live = stream->stream->wait_live(std::chrono::milliseconds(std::max(0, timeout_ms)));
    if (!live) return failed(live.error());
    return *live ? EC_OK : EC_NOTHING;
  });
}

ec_status ec_stream_get_stats(const ec_stream* stream, ec_stream_stats* stats) {
  return guarded([&] {
    if (stream == nullptr) return invalid("ec_stream_get_stats: stream is null");
    const SurfaceStream::Stats now = stream->stream->stats();
    ec_stream_stats result = EC_INIT(ec_stream_stats);
    result.live = !now.baking && now.publisher.state == Publisher::State::kLive ? 1 : 0;
    result.baking = now.baking ? 1 : 0;
    result.loose_faces = now.loose_faces ? 1 : 0;
    result.subscribers = now.publisher.subscribers;
    result.poses_taken = now.taken;
    result.poses_sent = now.frames_sent;
    result.poses_early = now.early;
    result.poses_superseded = now.superseded;
    result.poses_dropped = now.dropped;
    result.poses_unusable = now.unusable;
    result.bytes_sent = now.bytes_sent;
    result.bakes = now.bakes;
    result.reconnects = now.publisher.reconnects;
    result.detail = (stream->detail = now.detail).c_str();
    return give(stats, result);
  });
}

void ec_stream_release(ec_stream* stream) {
  delete stream;
}
