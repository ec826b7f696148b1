// SPDX-License-Identifier: MIT
// The C interface over the SDK's own C++: arguments are checked here, results become statuses, exceptions stop here.
#include <eigencast/eigencast.h>

#include <algorithm>
#include <cstring>
#include <deque>
#include <exception>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/core/clock.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"

struct ec_asset {
  std::shared_ptr<const eigencast::Asset> asset;
  std::shared_ptr<const eigencast::EncodedAsset> encoded;
  bool from_cache = false;
};

struct ec_publisher {
  std::unique_ptr<eigencast::Publisher> publisher;
  std::size_t vertices = 0, scalars = 0;
};

struct ec_subscriber {
  std::unique_ptr<eigencast::Subscriber> subscriber;
  std::deque<eigencast::ReceivedPose> waiting;
  std::optional<eigencast::ReceivedPose> current;
  std::vector<float> positions, normals, scalars, velocities;
  eigencast::Reconstructor reconstructor;
  std::vector<std::uint32_t> triangles;
  /// What `triangles` are of: a surface, as far as it had arrived, at a level.
  struct TrianglesOf {
    const eigencast::Asset* asset = nullptr;
    std::uint32_t epoch = 0, rows = 0, faces = 0, level = 0;
    bool operator==(const TrianglesOf&) const = default;
  };
  TrianglesOf triangles_of;
};

namespace eigencast {
namespace {

thread_local std::string last_error;

ec_status status_from(ErrorCode code) {
  switch (code) {
    case ErrorCode::kInvalidArgument:
      return EC_INVALID_ARGUMENT;
    case ErrorCode::kNotFound:
      return EC_NOT_FOUND;
    case ErrorCode::kCorrupt:
      return EC_CORRUPT;
    case ErrorCode::kTooLarge:
      return EC_TOO_LARGE;
    case ErrorCode::kUnsupported:
    case ErrorCode::kIncompatibleVersion:
      return EC_UNSUPPORTED;
    case ErrorCode::kIo:
      return EC_IO;
    case ErrorCode::kUnreachable:
    case ErrorCode::kDisconnected:
    case ErrorCode::kTimeout:
      return EC_UNREACHABLE;
    case ErrorCode::kRefused:
      return EC_REFUSED;
    case ErrorCode::kCancelled:
      return EC_CANCELLED;
    case ErrorCode::kNumerical:
      return EC_NUMERICAL;
    case ErrorCode::kInternal:
      return EC_INTERNAL;
  }
  return EC_INTERNAL;
}

ec_status failed(const Error& error) {
  last_error = error.message;
  return status_from(error.code);
}

ec_status invalid(const char* text) {
  return failed(fail(ErrorCode::kInvalidArgument, text));
}

/// Runs `body`, which returns an ec_status; no exception gets out.
template <typename Body>
ec_status guarded(Body&& body) {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return failed(fail(ErrorCode::kTooLarge, "out of memory"));
  } catch (const std::exception& error) {
    return failed(fail(ErrorCode::kInternal, error.what()));
  } catch (...) {
    return failed(fail(ErrorCode::kInternal, "unknown exception"));
  }
}

/// Options whose struct_size was forgotten would read as all defaults: refused instead.
template <typename Options>
bool lacks_size(const Options* given) {
  return given != nullptr && given->struct_size < sizeof(std::size_t);
}

/// The caller's struct with our defaults where it is absent or was built against an older, shorter one.
template <typename Options>
Options filled(const Options* given) {
  Options options = EC_INIT(Options);
  if (given != nullptr) std::memcpy(&options, given, std::min(given->struct_size, sizeof options));
  return options;
}

/// Copies a result into the caller's struct, as much of it as the caller knows.
template <typename Struct>
ec_status give(Struct* to, Struct from) {
  if (to == nullptr || to->struct_size < sizeof(std::size_t))
    return invalid("the result struct is null or its struct_size is not set");
  const std::size_t size = std::min(to->struct_size, sizeof from);
  from.struct_size = to->struct_size;
  std::memcpy(to, &from, size);
  return EC_OK;
}

/// Of either struct of options.
template <typename Options>
Credentials credentials_from(const Options& given) {
  const auto text = [](const char* value) { return std::string(value != nullptr ? value : ""); };
  return {text(given.token), text(given.ca_file), text(given.certificate_file), text(given.key_file),
          given.insecure != 0};
}

std::string text_or(const char* text, std::string fallback) {
  return text != nullptr ? text : std::move(fallback);
}

Result<Surface> surface_from(const double* positions, std::uint32_t vertices, const std::uint32_t* faces,
                             std::uint32_t face_count) {
  if (positions == nullptr || (faces == nullptr && face_count > 0)) {
    return fail(ErrorCode::kInvalidArgument, "ec_bake: positions, or faces with face_count > 0, is null");
  }
  Surface surface;
  surface.positions.resize(vertices);
  surface.faces.resize(face_count);
  for (std::size_t i = 0; i < vertices; ++i) std::copy_n(positions + 3 * i, 3, surface.positions[i].begin());
  for (std::size_t i = 0; i < face_count; ++i) std::copy_n(faces + 3 * i, 3, surface.faces[i].begin());
  return surface;
}

ec_status from_send(SendStatus status) {
  switch (status) {
    case SendStatus::kSent:
      return EC_OK;
    case SendStatus::kDropped:
      return EC_DROPPED;
    case SendStatus::kDisconnected:
      return EC_DISCONNECTED;
  }
  return EC_INTERNAL;
}

/// Whether the pose is one of the surface at hand. It may be of the one before, or come before any of the asset has
/// arrived.
bool can_rebuild(const Subscriber& subscriber, const ReceivedPose& pose) {
  const Asset* asset = subscriber.asset();
  return asset != nullptr && asset->rows_ready > 0 && pose.envelope.epoch == subscriber.epoch() && pose.channels >= 3 &&
         pose.coefficients.size() >= std::size_t{asset->rank} * pose.channels;
}

/// Channels `first` to first + count - 1 of the current pose, times `factor`, on the first N vertices: N x count.
std::vector<float> rebuilt_channels(const ec_subscriber& self, std::uint32_t first, std::uint32_t count, double factor,
                                    std::uint32_t N) {
  const ReceivedPose& pose = *self.current;
  const std::uint32_t rank = self.subscriber->asset()->rank;
  std::vector<float> values(std::size_t{N} * count), three(std::size_t{3} * N);
  std::vector<double> columns(std::size_t{3} * rank);
  for (std::uint32_t k = 0; k < count; k += 3) {  // the kernel takes three at a time
    const std::uint32_t width = std::min(3U, count - k);
    std::fill(columns.begin(), columns.end(), 0);
    for (std::size_t row = 0; row < rank; ++row) {
      for (std::uint32_t j = 0; j < width; ++j)
        columns[3 * row + j] = factor * pose.coefficients[row * pose.channels + first + k + j];
    }
    self.reconstructor.rebuild(columns, 3, rank, N, three);
    for (std::size_t i = 0; i < N; ++i) std::copy_n(&three[3 * i], width, &values[i * count + k]);
  }
  return values;
}

/// What rides on the current pose besides its positions.
void rebuild_riders(ec_subscriber& self, std::uint32_t N) {
  const std::uint32_t channels = self.current->channels;
  const auto& info = self.subscriber->info();
  const std::uint32_t v = info ? std::min(info->format.velocity_channels, channels - 3) : 0;
  self.scalars = rebuilt_channels(self, 3, channels - 3 - v, 1, N);
  self.velocities.clear();
  if (v == 3) self.velocities = rebuilt_channels(self, channels - v, v, 1e6 / info->format.velocity_us, N);
}

ec_status rebuild(ec_subscriber& self, double detail, ec_surface* out) {
  const Asset* asset = self.subscriber->asset();
  if (!self.current || !can_rebuild(*self.subscriber, *self.current)) {
    return failed(fail(ErrorCode::kNotFound,
                       "ec_subscriber_surface: no pose of the present surface has come yet; call ec_subscriber_next "
                       "until it returns EC_OK"));
  }
  if (!(detail >= 0 && detail <= 1)) return invalid("ec_subscriber_surface: detail must lie in 0..1");
  const std::uint32_t level = level_from_fraction(*asset, detail);
  const ec_subscriber::TrianglesOf wanted{asset, self.subscriber->epoch(), asset->rows_ready, asset->faces_ready,
                                          level};
  if (self.triangles_of.asset != asset || self.triangles_of.epoch != wanted.epoch) self.reconstructor.reset();
  self.reconstructor.update(*asset);
  if (self.triangles_of != wanted) {
    self.triangles = triangles_at_level(*asset, level);
    self.triangles_of = wanted;
  }
  self.positions.resize(std::size_t{3} * level);
  const ReceivedPose& pose = *self.current;
  self.reconstructor.rebuild(pose.coefficients, pose.channels, asset->rank, level, self.positions);
  self.normals.resize(asset->is_point_cloud() ? 0 : self.positions.size());
  if (!self.normals.empty()) vertex_normals(self.positions, self.triangles, self.normals);
  for (std::size_t i = 0; i < self.positions.size(); ++i) self.positions[i] += static_cast<float>(asset->origin[i % 3]);

  rebuild_riders(self, level);

  ec_surface surface = EC_INIT(ec_surface);
  surface.vertex_count = level;
  surface.triangle_count = static_cast<std::uint32_t>(self.triangles.size() / 3);
  surface.positions = self.positions.data();
  surface.normals = self.normals.empty() ? nullptr : self.normals.data();
  surface.triangles = self.triangles.data();
  surface.source_vertex = asset->source_vertex.data();
  surface.capture_us = pose.envelope.capture_us;
  surface.sequence = pose.envelope.sequence;
  surface.interpolated = pose.envelope.step.of != 0 && pose.envelope.step.at != pose.envelope.step.of;
  surface.scalar_count = static_cast<std::uint32_t>(self.scalars.size() / level);
  surface.scalars = self.scalars.empty() ? nullptr : self.scalars.data();
  surface.velocities = self.velocities.empty() ? nullptr : self.velocities.data();
  return give(out, surface);
}

/// A caller's array of so many values for each vertex, where the publisher was made for it.
std::span<const float> rows_of(const float* values, std::size_t vertices, std::size_t width) {
  return values == nullptr ? std::span<const float>() : std::span(values, vertices * width);
}

}  // namespace
}  // namespace eigencast

using namespace eigencast;

const char* ec_version(void) {
  return EIGENCAST_VERSION;
}

const char* ec_strerror(ec_status status) {
  switch (status) {
    case EC_OK:
      return "ok";
    case EC_DROPPED:
      return "dropped";
    case EC_DISCONNECTED:
      return "disconnected";
    case EC_NOTHING:
      return "nothing";
    case EC_INVALID_ARGUMENT:
      return "invalid-argument";
    case EC_NOT_FOUND:
      return "not-found";
    case EC_CORRUPT:
      return "corrupt";
    case EC_TOO_LARGE:
      return "too-large";
    case EC_UNSUPPORTED:
      return "unsupported";
    case EC_IO:
      return "io";
    case EC_UNREACHABLE:
      return "unreachable";
    case EC_REFUSED:
      return "refused";
    case EC_CANCELLED:
      return "cancelled";
    case EC_NUMERICAL:
      return "numerical";
    case EC_INTERNAL:
      return "internal";
  }
  return "unknown";
}

const char* ec_last_error(void) {
  return last_error.c_str();
}

int64_t ec_now_us(void) {
  return steady_now_us();
}

ec_status ec_bake(const double* positions, uint32_t vertex_count, const uint32_t* faces, uint32_t face_count,
                  const ec_bake_options* options, ec_asset** asset) {
  return guarded([&] {
    if (asset == nullptr) return invalid("ec_bake: asset is null");
    if (lacks_size(options)) return invalid("ec_bake: struct_size of the options is not set; use EC_INIT");
    const ec_bake_options given = filled(options);
    const auto surface = surface_from(positions, vertex_count, faces, face_count);
    if (!surface) return failed(surface.error());
    BakeOptions bake_options;
    bake_options.basis = text_or(given.basis, bake_options.basis);
    bake_options.name = text_or(given.name, {});
    if (given.rank > 0) bake_options.rank = static_cast<int>(std::min<std::uint32_t>(given.rank, 1u << 20));
    BakeProgress progress;
    if (given.progress != nullptr) {
      progress = [&given](double fraction, std::string_view stage) {
        return given.progress(given.user, fraction, std::string(stage).c_str()) == 0;
      };
    }
    auto baked =
        bake(*surface, bake_options, given.cache_dir != nullptr ? given.cache_dir : default_cache_dir(), progress);
    if (!baked) return failed(baked.error());
    *asset = new ec_asset{std::make_shared<const Asset>(std::move(baked->asset)),
                          std::make_shared<const EncodedAsset>(std::move(baked->encoded)), baked->from_cache};
    return EC_OK;
  });
}

ec_status ec_asset_get_info(const ec_asset* asset, ec_asset_info* info) {
  return guarded([&] {
    if (asset == nullptr) return invalid("ec_asset_get_info: asset is null");
    ec_asset_info result = EC_INIT(ec_asset_info);
    result.vertex_count = asset->asset->vertex_count;
    result.face_count = asset->asset->face_total;
    result.rank = asset->asset->rank;
    result.from_cache = asset->from_cache ? 1 : 0;
    const std::string id = asset->encoded->manifest.id.hex();
    std::copy_n(id.c_str(), sizeof result.id, result.id);
    return give(info, result);
  });
}

void ec_asset_release(ec_asset* asset) {
  delete asset;
}

ec_status ec_publisher_create(const char* url, const ec_asset* asset, const ec_publisher_options* options,
                              ec_publisher** publisher) {
  return guarded([&] {
    if (url == nullptr || asset == nullptr || publisher == nullptr)
      return invalid("ec_publisher_create: url, asset or publisher is null");
    if (lacks_size(options)) return invalid("ec_publisher_create: struct_size of the options is not set; use EC_INIT");
    const ec_publisher_options given = filled(options);
    PublisherOptions publisher_options;
    publisher_options.url = url;
    publisher_options.credentials = credentials_from(given);
    const auto codec = codec_from_name(text_or(given.codec, "quantised"));
    if (!codec) return failed(codec.error());
    publisher_options.codec = *codec;
    publisher_options.error = given.error;
    publisher_options.bitrate = given.bitrate;
    publisher_options.still_heartbeat_us = given.still_heartbeat_us;
    if (given.key_rate_hz > 0) publisher_options.key_rate_hz = given.key_rate_hz;
    publisher_options.scalars = given.scalars;
    publisher_options.velocities = given.velocities != 0;
    auto created = Publisher::create(publisher_options, asset->asset, asset->encoded);
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
    return sent ? from_send(*sent) : failed(sent.error());
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
    return sent ? from_send(*sent) : failed(sent.error());
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
    return give(stats, result);
  });
}

void ec_publisher_release(ec_publisher* publisher) {
  delete publisher;
}

ec_status ec_subscriber_create(const char* url, const ec_subscriber_options* options, ec_subscriber** subscriber) {
  return guarded([&] {
    if (url == nullptr || subscriber == nullptr) return invalid("ec_subscriber_create: url or subscriber is null");
    if (lacks_size(options)) return invalid("ec_subscriber_create: struct_size of the options is not set; use EC_INIT");
    const ec_subscriber_options given = filled(options);
    SubscriberOptions subscriber_options;
    subscriber_options.url = url;
    subscriber_options.credentials = credentials_from(given);
    subscriber_options.cache_dir = given.cache_dir != nullptr ? given.cache_dir : default_cache_dir();
    auto created = Subscriber::create(subscriber_options);
    if (!created) return failed(created.error());
    auto result = std::make_unique<ec_subscriber>();
    result->subscriber = std::move(*created);
    *subscriber = result.release();
    return EC_OK;
  });
}

ec_status ec_subscriber_next(ec_subscriber* subscriber, int timeout_ms) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_next: subscriber is null");
    if (subscriber->waiting.empty()) {
      for (ReceivedPose& pose : subscriber->subscriber->poll(std::chrono::milliseconds(std::max(0, timeout_ms)))) {
        subscriber->waiting.push_back(std::move(pose));
      }
    }
    while (!subscriber->waiting.empty() && !can_rebuild(*subscriber->subscriber, subscriber->waiting.front())) {
      subscriber->waiting.pop_front();
    }
    if (subscriber->waiting.empty()) return EC_NOTHING;
    subscriber->current = std::move(subscriber->waiting.front());
    subscriber->waiting.pop_front();
    return EC_OK;
  });
}

ec_status ec_subscriber_surface(ec_subscriber* subscriber, double detail, ec_surface* surface) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_surface: subscriber is null");
    return rebuild(*subscriber, detail, surface);
  });
}

ec_status ec_subscriber_get_stats(const ec_subscriber* subscriber, ec_subscriber_stats* stats) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_get_stats: subscriber is null");
    const Subscriber::Stats now = subscriber->subscriber->stats();
    ec_subscriber_stats result = EC_INIT(ec_subscriber_stats);
    result.live = now.state == Subscriber::State::kLive ? 1 : 0;
    result.keys = now.keys;
    result.interpolated = now.synthetic;
    result.bytes_received = now.bytes;
    result.missed = now.missed;
    result.reconnects = now.reconnects;
    result.latency_p50_us = now.latency_us.percentile(50);
    result.latency_p99_us = now.latency_us.percentile(99);
    return give(stats, result);
  });
}

void ec_subscriber_release(ec_subscriber* subscriber) {
  delete subscriber;
}
