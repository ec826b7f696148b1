// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <deque>
#include <limits>
#include <optional>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/abi.h"
#include "sdk/asset_cache.h"
#include "sdk/past_view.h"
#include "sdk/subscriber.h"

struct ec_subscriber {
  eigencast::abi::OfProcess home;
  std::optional<eigencast::MemoryBudget> memory;  ///< Outlives the subscriber.
  std::unique_ptr<eigencast::Subscriber> subscriber;
  eigencast::PastView past;
  std::vector<ec_kept_span> kept;
  std::deque<eigencast::ReceivedPose> waiting;
  std::optional<eigencast::ReceivedPose> current;
  std::vector<float> positions, normals, scalars, velocities;
  std::vector<ec_scalar> scalar_info;  ///< Points into the subscriber's info().
  eigencast::Reconstructor reconstructor;
  std::vector<std::uint32_t> triangles;
  std::vector<float> corner_uv;
  /// What `triangles` and `corner_uv` are of: a surface, as far as it had arrived, at a level.
  struct TrianglesOf {
    const eigencast::Asset* asset = nullptr;
    std::uint32_t epoch = 0, rows = 0, faces = 0, level = 0;
    bool operator==(const TrianglesOf&) const = default;
  };
  TrianglesOf triangles_of;
};

namespace eigencast {
namespace {

using namespace abi;

/// It may be of the surface before, or come before any of the asset has arrived.
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
    self.reconstructor.combine(columns, 3, rank, N, three);
    for (std::size_t i = 0; i < N; ++i) std::copy_n(&three[3 * i], width, &values[i * count + k]);
  }
  return values;
}

void rebuild_riders(ec_subscriber& self, std::uint32_t N) {
  const std::uint32_t channels = self.current->channels;
  const auto& info = self.subscriber->info();
  const std::uint32_t v = info ? std::min(info->format.velocity_channels, channels - 3) : 0;
  self.scalars = rebuilt_channels(self, 3, channels - 3 - v, 1, N);
  self.scalar_info.clear();
  if (info && info->format.channels == channels)
    for (const auto& [name, unit, low, high, scale] : info->format.scalars)
      self.scalar_info.push_back({name.c_str(), unit.c_str(), low, high, 0});
  self.velocities.clear();
  if (v == 3) self.velocities = rebuilt_channels(self, channels - v, v, 1e6 / info->format.velocity_us, N);
}

/// UV of the corners of the triangles of level N; empty where there is no texture.
std::vector<float> corner_uv_at_level(const Asset& asset, std::uint32_t N, std::size_t corners) {
  if (!asset.texture) return {};
  const AssetTexture& texture = *asset.texture;
  std::vector<float> corner_uv(2 * corners, std::numeric_limits<float>::quiet_NaN());
  for (std::size_t corner = 0; corner < corners; ++corner) {
    std::uint32_t wedge = texture.corners[corner / 3][corner % 3];
    while (wedge >= texture.first_wedge[N]) wedge = texture.parent[wedge];
    if (texture.uvs[wedge] == AssetTexture::kNone) continue;
    const std::array<float, 2> uv = texture.uv(wedge);
    std::copy(uv.begin(), uv.end(), &corner_uv[2 * corner]);
  }
  return corner_uv;
}

/// Puts the next pose that can be shown before all that wait. False: none. Errors: a seek was not done.
Result<bool> find_next(ec_subscriber& self, TimeUs timeout_us) {
  if (self.waiting.empty()) {
    for (ReceivedPose& pose : self.subscriber->poll(std::chrono::milliseconds(timeout_us / 1000)))
      self.waiting.push_back(std::move(pose));
    if (const Result<void> sought = self.past.advance(*self.subscriber, steady_now_us()); !sought)
      return sought.error();
  }
  const auto passes = [&](const ReceivedPose& pose) {
    return can_rebuild(*self.subscriber, pose) && self.past.is_wanted(pose.envelope.epoch, *self.subscriber);
  };
  while (!self.waiting.empty() && !passes(self.waiting.front())) self.waiting.pop_front();
  return !self.waiting.empty();
}

template <typename LevelOf>
ec_status rebuild(ec_subscriber& self, const LevelOf& level_of, ec_surface* out) {
  const Asset* asset = self.subscriber->asset();
  if (!self.current || !can_rebuild(*self.subscriber, *self.current)) {
    return failed(fail(ErrorCode::kNotFound,
                       "ec_subscriber_surface: no pose of the present surface has come yet; call ec_subscriber_next "
                       "until it returns EC_OK"));
  }
  const std::uint32_t level = level_of(*asset);
  const ec_subscriber::TrianglesOf wanted{asset, self.subscriber->epoch(), asset->rows_ready, asset->faces_ready,
                                          level};
  if (self.triangles_of.asset != asset || self.triangles_of.epoch != wanted.epoch) self.reconstructor.reset();
  self.reconstructor.update(*asset);
  if (self.triangles_of != wanted) {
    self.triangles = triangles_at_level(*asset, level);
    self.corner_uv = corner_uv_at_level(*asset, level, self.triangles.size());
    self.triangles_of = wanted;
  }
  self.positions.resize(std::size_t{3} * level);
  const bool has_detail = self.reconstructor.has_detail();
  self.normals.resize(asset->is_point_cloud() && !has_detail ? 0 : self.positions.size());
  const ReceivedPose& pose = *self.current;
  PoseToRebuild wish{pose.coefficients, pose.channels, self.positions, {}};
  if (has_detail) wish.normals = self.normals;
  self.reconstructor.rebuild({&wish, 1}, asset->rank, level);
  if (!has_detail && !self.normals.empty()) vertex_normals(self.positions, self.triangles, self.normals);
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
  surface.scalar_info = self.scalar_info.empty() ? nullptr : self.scalar_info.data();
  surface.scalars = self.scalars.empty() ? nullptr : self.scalars.data();
  surface.velocities = self.velocities.empty() ? nullptr : self.velocities.data();
  surface.vertex_colours = asset->colours.empty() ? nullptr : asset->colours.front().data();
  if (!self.corner_uv.empty()) {
    surface.corner_uv = self.corner_uv.data();
    surface.image = asset->texture->image.data();
    surface.image_size = asset->texture->image.size();
  }
  return give(out, surface);
}

ec_status sought(ec_subscriber& self, TimeUs at_us, double speed, bool next) {
  if (const Result<void> good = self.past.seek(at_us, speed, next); !good) return failed(good.error());
  self.waiting.clear();
  return EC_OK;
}

/// The moment of the current pose; nothing: it is not of the past.
std::optional<TimeUs> past_us(const ec_subscriber& self) {
  const auto& info = self.subscriber->info();
  if (!self.current || !info || !info->rewind || self.current->envelope.epoch != info->epoch) return std::nullopt;
  return moment_of(*info->rewind, self.current->envelope.capture_us);
}

}  // namespace
}  // namespace eigencast

using namespace eigencast;
using namespace eigencast::abi;

ec_status ec_subscriber_create(const char* url, const ec_subscriber_options* options, ec_subscriber** subscriber) {
  return guarded([&] {
    if (url == nullptr || subscriber == nullptr) return invalid("ec_subscriber_create: url or subscriber is null");
    if (lacks_size(options)) return invalid("ec_subscriber_create: struct_size of the options is not set; use EC_INIT");
    const ec_subscriber_options given = filled(options);
    SubscriberOptions subscriber_options;
    subscriber_options.url = url;
    subscriber_options.credentials = credentials_from(given);
    subscriber_options.cache_dir = given.cache_dir != nullptr ? given.cache_dir : default_cache_dir();
    auto result = std::make_unique<ec_subscriber>();
    if (given.max_memory_bytes > 0) subscriber_options.memory = &result->memory.emplace(given.max_memory_bytes);
    auto created = Subscriber::create(subscriber_options);
    if (!created) return failed(created.error());
    result->subscriber = std::move(*created);
    *subscriber = result.release();
    return EC_OK;
  });
}

ec_status ec_subscriber_next(ec_subscriber* subscriber, int timeout_ms) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_next: subscriber is null");
    const TimeUs end_us = steady_now_us() + TimeUs{std::max(0, timeout_ms)} * 1000;
    do {
      const Result<bool> found = find_next(*subscriber, std::max<TimeUs>(0, end_us - steady_now_us()));
      if (!found) return failed(found.error());
      if (*found) break;
    } while (subscriber->past.waits() && steady_now_us() < end_us);
    if (subscriber->waiting.empty()) return EC_NOTHING;
    subscriber->current = std::move(subscriber->waiting.front());
    subscriber->waiting.pop_front();
    return EC_OK;
  });
}

ec_status ec_subscriber_surface(ec_subscriber* subscriber, double detail, ec_surface* surface) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_surface: subscriber is null");
    if (!(detail >= 0 && detail <= 1)) return invalid("ec_subscriber_surface: detail must lie in 0..1");
    return rebuild(
        *subscriber, [detail](const Asset& asset) { return level_from_fraction(asset, detail); }, surface);
  });
}

ec_status ec_subscriber_surface_within(ec_subscriber* subscriber, uint32_t max_vertices, ec_surface* surface) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_surface_within: subscriber is null");
    const auto level = [max_vertices](const Asset& asset) {
      return std::min(std::max(max_vertices, asset.base_count), asset.rows_ready);
    };
    return rebuild(*subscriber, level, surface);
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
    result.retry_in_us = now.retry_in.value_or(0);
    return give(stats, result);
  });
}

ec_status ec_subscriber_seek(ec_subscriber* subscriber, int64_t at_us, double speed) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_seek: subscriber is null");
    return sought(*subscriber, at_us, speed, false);
  });
}

ec_status ec_subscriber_step(ec_subscriber* subscriber, int forward) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_step: subscriber is null");
    const auto at_us = past_us(*subscriber);
    if (!at_us) {
      return failed(fail(ErrorCode::kNotFound,
                         "ec_subscriber_step: the current pose is not of the past; call ec_subscriber_seek() first"));
    }
    return sought(*subscriber, forward != 0 ? *at_us : std::max<TimeUs>(0, *at_us - 1), 0, forward != 0);
  });
}

ec_status ec_subscriber_live(ec_subscriber* subscriber) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_live: subscriber is null");
    subscriber->waiting.clear();
    subscriber->past.show_present();
    return EC_OK;
  });
}

ec_status ec_subscriber_get_past(ec_subscriber* subscriber, ec_past* past) {
  return guarded([&] {
    if (subscriber == nullptr) return invalid("ec_subscriber_get_past: subscriber is null");
    ec_past result = EC_INIT(ec_past);
    subscriber->kept.clear();
    const TimeUs now_us = steady_now_us();
    if (const auto kept = subscriber->past.kept(*subscriber->subscriber, now_us)) {
      for (const auto& [from_us, to_us] : kept->spans) subscriber->kept.push_back({from_us, to_us});
      result.now_us = kept->now_at(now_us);
    }
    result.spans = subscriber->kept.empty() ? nullptr : subscriber->kept.data();
    result.span_count = subscriber->kept.size();
    const auto at_us = past_us(*subscriber);
    result.is_past = at_us ? 1 : 0;
    result.at_us = at_us.value_or(0);
    return give(past, result);
  });
}

void ec_subscriber_release(ec_subscriber* subscriber) {
  release_at_home(subscriber);
}
