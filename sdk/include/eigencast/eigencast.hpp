// SPDX-License-Identifier: MIT
#pragma once

#include <eigencast/eigencast.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>

/// The C interface of libeigencast as C++ objects. Everything here is inline: nothing of the standard library crosses
/// into the library. Constructors and functions throw Error; send() and next() report their outcomes as values.
namespace eigencast {

/// What went wrong: status() is stable, what() is for people.
class Error : public std::runtime_error {
 public:
  explicit Error(ec_status status) : std::runtime_error(ec_last_error()), status_(status) {}
  ec_status status() const { return status_; }

 private:
  ec_status status_;
};

/// Throws Error if `status` is an error; otherwise gives it back.
inline ec_status check(ec_status status) {
  if (status < 0) throw Error(status);
  return status;
}

/// Now, in microseconds, on the clock of capture times.
inline std::int64_t now_us() {
  return ec_now_us();
}

/// A surface's colours and image; see ec_appearance. Needed until bake() returns.
struct Appearance {
  std::span<const std::uint8_t> vertex_colours = {};  ///< 3 per vertex: red, green, blue, sRGB.
  std::span<const std::uint8_t> image = {};           ///< A whole PNG or JPEG file.
  std::span<const float> corner_uv = {};              ///< 6 per triangle; (0, 0): the image's upper left corner.
  std::span<const float> vertex_uv = {};              ///< 2 per vertex, instead.
};

struct BakeOptions {
  std::string basis = "augmented";                         ///< See ec_bake_options.
  std::uint32_t rank = 0;                                  ///< Coefficients per axis; 0: see ec_bake_options.
  std::string name = {};                                   ///< Of the surface, for people.
  std::optional<std::string> cache_dir = {};               ///< Empty text: nowhere (default: the user's cache folder).
  std::function<bool(double, const char*)> progress = {};  ///< Fraction and stage; return false to cancel.
  std::optional<Appearance> appearance = {};               ///< Colours and texture.
  std::string solver = "lanczos";                          ///< or "spectra", for small surfaces
  double quality = 0, target_error = 0, bitrate = 0;       ///< Without a rank: see ec_bake_options.
  std::span<const float> poses = {};                       ///< An example of the motion: 3 per vertex and pose.
  double pose_rate_hz = 30;
  std::span<const double> columns = {};    ///< Of a rig or cage: as many per vertex as there are columns.
  std::optional<std::string> detail = {};  ///< See ec_bake_options.
};

/// A surface that can be streamed. Cheap to copy: copies share it. Thread-safe: immutable.
class Asset {
 public:
  /// Bakes a surface.
  ///   positions  3 numbers per vertex
  ///   faces      3 vertex numbers per triangle, counter-clockwise from outside; empty for a point cloud
  static Asset bake(std::span<const double> positions, std::span<const std::uint32_t> faces,
                    const BakeOptions& options = {}) {
    auto c_options = EC_INIT(ec_bake_options);
    c_options.basis = options.basis.c_str();
    c_options.rank = options.rank;
    c_options.name = options.name.c_str();
    c_options.solver = options.solver.c_str();
    c_options.cache_dir = options.cache_dir ? options.cache_dir->c_str() : nullptr;
    c_options.quality = options.quality;
    c_options.target_error = options.target_error;
    c_options.bitrate = options.bitrate;
    if (!positions.empty() && options.poses.size() % positions.size() != 0)
      throw std::invalid_argument("Asset::bake: poses are not 3 per vertex each");
    c_options.poses = options.poses.data();
    c_options.pose_count =
        static_cast<std::uint32_t>(options.poses.size() / std::max<std::size_t>(positions.size(), 1));
    c_options.pose_rate_hz = options.pose_rate_hz;
    const std::size_t vertices = std::max<std::size_t>(positions.size() / 3, 1);
    if (options.columns.size() % vertices != 0)
      throw std::invalid_argument("Asset::bake: columns are not as many for each vertex");
    c_options.columns = options.columns.data();
    c_options.column_count = static_cast<std::uint32_t>(options.columns.size() / vertices);
    c_options.detail = options.detail ? options.detail->c_str() : nullptr;
    if (options.progress) {
      c_options.progress = [](void* user, double fraction, const char* stage) {
        return static_cast<const BakeOptions*>(user)->progress(fraction, stage) ? 0 : 1;
      };
      c_options.user = const_cast<BakeOptions*>(&options);
    }
    auto appearance = EC_INIT(ec_appearance);
    if (options.appearance) {
      const Appearance& style = *options.appearance;
      const auto given = [](auto values, std::size_t wanted, const char* what) {
        if (!values.empty() && values.size() != wanted) throw std::invalid_argument(what);
        return values.empty() ? nullptr : values.data();
      };
      appearance.vertex_colours =
          given(style.vertex_colours, positions.size(), "Asset::bake: vertex_colours are not 3 per vertex");
      appearance.corner_uv = given(style.corner_uv, 2 * faces.size(), "Asset::bake: corner_uv are not 6 per triangle");
      appearance.vertex_uv =
          given(style.vertex_uv, positions.size() / 3 * 2, "Asset::bake: vertex_uv are not 2 per vertex");
      appearance.image = style.image.empty() ? nullptr : style.image.data();
      appearance.image_size = style.image.size();
      c_options.appearance = &appearance;
    }
    ec_asset* asset = nullptr;
    check(ec_bake(positions.data(), static_cast<std::uint32_t>(positions.size() / 3), faces.data(),
                  static_cast<std::uint32_t>(faces.size() / 3), &c_options, &asset));
    return Asset(asset);
  }

  /// Loads what save() or `eigencast-sender bake --out` wrote. id: the content id, as the bake gave it.
  static Asset load(const std::string& folder, const std::string& id) {
    ec_asset* asset = nullptr;
    check(ec_asset_load(folder.c_str(), id.c_str(), &asset));
    return Asset(asset);
  }
  void save(const std::string& folder) const { check(ec_asset_save(asset_.get(), folder.c_str())); }

  ec_asset_info info() const {
    auto info = EC_INIT(ec_asset_info);
    check(ec_asset_get_info(asset_.get(), &info));
    return info;
  }
  const ec_asset* get() const { return asset_.get(); }

 private:
  explicit Asset(ec_asset* asset) : asset_(asset, ec_asset_release) {}
  std::shared_ptr<ec_asset> asset_;
};

/// Triangles over some of a program's points: see ec_mesh.
struct Mesh {
  std::vector<std::uint32_t> vertices;  ///< Numbers of points, growing; empty: all points.
  std::vector<std::uint32_t> faces;     ///< 3 numbers of `vertices` per triangle.

  static Mesh triangles(std::span<const std::uint32_t> connectivity, std::span<const std::uint64_t> offsets) {
    return taken([&](ec_mesh** mesh) {
      return ec_mesh_triangles(connectivity.data(), connectivity.size(), offsets.data(), offsets.size(), mesh);
    });
  }
  static Mesh boundary(std::span<const double> points, std::span<const std::uint32_t> cells, const std::string& kind) {
    return taken([&](ec_mesh** mesh) {
      return ec_mesh_boundary(points.data(), static_cast<std::uint32_t>(points.size() / 3), cells.data(), cells.size(),
                              kind.c_str(), mesh);
    });
  }
  static Mesh weld(std::span<const double> points, std::span<const std::uint32_t> faces, double tolerance) {
    return taken([&](ec_mesh** mesh) {
      return ec_mesh_weld(points.data(), static_cast<std::uint32_t>(points.size() / 3), faces.data(),
                          static_cast<std::uint32_t>(faces.size() / 3), tolerance, mesh);
    });
  }

 private:
  template <typename Make>
  static Mesh taken(const Make& make) {
    ec_mesh* made = nullptr;
    check(make(&made));
    const std::unique_ptr<ec_mesh, void (*)(ec_mesh*)> mesh(made, ec_mesh_release);
    auto arrays = EC_INIT(ec_mesh_arrays);
    check(ec_mesh_get(made, &arrays));
    return {{arrays.vertices, arrays.vertices + arrays.vertex_count},
            {arrays.faces, arrays.faces + std::size_t{3} * arrays.face_count}};
  }
};

/// How a client identifies itself, and which authorities it trusts.
struct Access {
  std::string token = {};             ///< "@FILE" reads it; empty: EIGENCAST_TOKEN of the environment.
  std::string ca_file = {};           ///< PEM file of the authorities trusted for https://; empty: the system's.
  std::string certificate_file = {};  ///< PEM file of a certificate of your own, for brokers that ask for one.
  std::string key_file = {};          ///< PEM file of its private key.
  bool insecure = false;              ///< The broker's certificate is not checked; for trying out only.

  /// Points into this object, which must outlive the call that `options` are for.
  template <typename COptions>
  void give_to(COptions& options) const {
    options.token = token.c_str();
    options.ca_file = ca_file.c_str();
    options.certificate_file = certificate_file.c_str();
    options.key_file = key_file.c_str();
    options.insecure = insecure ? 1 : 0;
  }
};

/// See ec_scalar.
struct Scalar {
  std::string name, unit = {};
  double low = 0, high = 0, error = 0;
};

struct PublisherOptions {
  std::string codec = "quantised";            ///< or "float32", "float64"
  double error = 0;                           ///< Vertex error of quantising, model units; 0: see ec_publisher_options.
  double key_rate_hz = 30;                    ///< Intended poses a second.
  double bitrate = 0;                         ///< Bits a second to keep to; 0: as the error takes.
  std::int64_t still_heartbeat_us = 0;        ///< While the surface stands still, send it only so often; 0: every pose.
  Access access = {};                         ///< How the broker lets you in.
  std::vector<Scalar> scalars = {};           ///< Values that ride on each vertex.
  bool velocities = false;                    ///< Poses come with velocities.
  std::string memory = "auto", learn = "off";  ///< See ec_publisher_options.
};

/// Publishes one deforming surface. Not thread-safe; different Publishers are independent.
class Publisher {
 public:
  Publisher(const std::string& url, const Asset& asset, const PublisherOptions& options = {})
      : publisher_(nullptr, ec_publisher_release) {
    std::vector<ec_scalar> scalars;
    const auto c_options = c_options_of(options, scalars);
    ec_publisher* publisher = nullptr;
    check(ec_publisher_create(url.c_str(), asset.get(), &c_options, &publisher));
    publisher_.reset(publisher);
    vertices_ = asset.info().vertex_count;
    scalars_ = options.scalars.size();
    velocities_ = options.velocities;
  }

  /// For the C interface; points into `options` and `scalars`.
  static ec_publisher_options c_options_of(const PublisherOptions& options, std::vector<ec_scalar>& scalars) {
    auto c_options = EC_INIT(ec_publisher_options);
    c_options.codec = options.codec.c_str();
    c_options.error = options.error;
    c_options.key_rate_hz = options.key_rate_hz;
    c_options.bitrate = options.bitrate;
    c_options.still_heartbeat_us = options.still_heartbeat_us;
    for (const auto& [name, unit, low, high, error] : options.scalars)
      scalars.push_back({name.c_str(), unit.c_str(), low, high, error});
    c_options.scalars = static_cast<std::uint32_t>(scalars.size());
    c_options.scalar_info = scalars.data();
    c_options.velocities = options.velocities ? 1 : 0;
    c_options.memory = options.memory.c_str();
    c_options.learn = options.learn.c_str();
    options.access.give_to(c_options);
    return c_options;
  }

  /// Sends a pose: 3 numbers per vertex, in the order that was baked. Never blocks.
  /// Returns EC_OK, EC_DROPPED (the next one supersedes it) or EC_DISCONNECTED (it reconnects by itself).
  [[nodiscard]] ec_status send(std::span<const float> positions, std::int64_t capture_us = now_us()) {
    return send(positions, {}, {}, capture_us);
  }
  /// The same with 3 numbers per vertex and second, or none, and the scalars of each vertex, as many as were announced.
  [[nodiscard]] ec_status send(std::span<const float> positions, std::span<const float> velocities,
                               std::span<const float> scalars, std::int64_t capture_us = now_us()) {
    if (positions.size() != 3 * vertices_ || velocities.size() != (velocities_ ? 3 * vertices_ : 0) ||
        scalars.size() != scalars_ * vertices_) {
      throw std::invalid_argument(
          "Publisher::send: 3 numbers per vertex of the asset, and velocities and scalars as announced");
    }
    auto pose = EC_INIT(ec_pose);
    pose.positions = positions.data();
    pose.velocities = velocities.empty() ? nullptr : velocities.data();
    pose.scalars = scalars.empty() ? nullptr : scalars.data();
    pose.capture_us = capture_us;
    return check(ec_publisher_send_pose(publisher_.get(), &pose));
  }

  /// Waits at most `timeout` until poses go out; false: not yet.
  [[nodiscard]] bool wait_live(std::chrono::milliseconds timeout) const {
    return check(ec_publisher_wait_live(publisher_.get(), static_cast<int>(timeout.count()))) == EC_OK;
  }

  /// `detail` stays until the next call.
  ec_publisher_stats stats() const {
    auto stats = EC_INIT(ec_publisher_stats);
    check(ec_publisher_get_stats(publisher_.get(), &stats));
    return stats;
  }

 private:
  std::unique_ptr<ec_publisher, void (*)(ec_publisher*)> publisher_;
  std::size_t vertices_ = 0, scalars_ = 0;
  bool velocities_ = false;
};

struct StreamOptions {
  std::uint32_t rank = 200;  ///< As of BakeOptions.
  std::string basis = "augmented", name = {};
  std::optional<std::string> cache_dir = {};
  PublisherOptions publisher = {};  ///< velocities and key_rate_hz are found out.
  bool z_up = false;                ///< Of what is sent.
  double scale = 1;
  double max_rate_hz = 30;  ///< Infinity: no limit.
  bool rebake = true;       ///< Another topology than the first is another surface, else an error.
};

/// Bakes and publishes in one: see ec_stream. Not thread-safe; different Streams are independent.
class Stream {
 public:
  explicit Stream(const std::string& url, const StreamOptions& options = {}) : stream_(nullptr, ec_stream_release) {
    auto bake = EC_INIT(ec_bake_options);
    bake.rank = options.rank;
    bake.basis = options.basis.c_str();
    bake.name = options.name.c_str();
    bake.cache_dir = options.cache_dir ? options.cache_dir->c_str() : nullptr;
    std::vector<ec_scalar> scalars;
    auto publisher = Publisher::c_options_of(options.publisher, scalars);
    auto c_options = EC_INIT(ec_stream_options);
    c_options.bake = &bake;
    c_options.publisher = &publisher;
    c_options.up = options.z_up ? "z" : "y";
    c_options.scale = options.scale;
    c_options.max_rate_hz = options.max_rate_hz;
    c_options.refuse_topology = options.rebake ? 0 : 1;
    ec_stream* stream = nullptr;
    check(ec_stream_create(url.c_str(), &c_options, &stream));
    stream_.reset(stream);
  }

  /// Returns EC_OK, EC_BAKING or EC_DISCONNECTED.
  [[nodiscard]] ec_status send(const ec_frame& frame) { return check(ec_stream_send(stream_.get(), &frame)); }
  /// Points, 3 numbers each, and triangles, 3 corners each; no corners: as before.
  [[nodiscard]] ec_status send(std::span<const float> points, std::span<const std::uint32_t> corners = {}) {
    auto frame = EC_INIT(ec_frame);
    frame.points = points.data();
    frame.point_count = static_cast<std::uint32_t>(points.size() / 3);
    frame.corners = corners.data();
    frame.corner_count = corners.size();
    return send(frame);
  }
  /// Waits at most `timeout` until poses go out; false: not yet.
  [[nodiscard]] bool wait_live(std::chrono::milliseconds timeout) {
    return check(ec_stream_wait_live(stream_.get(), static_cast<int>(timeout.count()))) == EC_OK;
  }
  /// `detail` stays until the next call.
  ec_stream_stats stats() const {
    auto stats = EC_INIT(ec_stream_stats);
    check(ec_stream_get_stats(stream_.get(), &stats));
    return stats;
  }

 private:
  std::unique_ptr<ec_stream, void (*)(ec_stream*)> stream_;
};

/// Watches one stream. Not thread-safe; different Subscribers are independent.
class Subscriber {
 public:
  /// cache_dir: where downloaded assets are kept; empty text: nowhere; nothing: the user's cache folder.
  /// max_memory_bytes: see ec_subscriber_options.
  explicit Subscriber(const std::string& url, const std::optional<std::string>& cache_dir = {},
                      const Access& access = {}, std::uint64_t max_memory_bytes = 0)
      : subscriber_(nullptr, ec_subscriber_release) {
    auto c_options = EC_INIT(ec_subscriber_options);
    c_options.max_memory_bytes = max_memory_bytes;
    c_options.cache_dir = cache_dir ? cache_dir->c_str() : nullptr;
    access.give_to(c_options);
    ec_subscriber* subscriber = nullptr;
    check(ec_subscriber_create(url.c_str(), &c_options, &subscriber));
    subscriber_.reset(subscriber);
  }

  /// Goes on to the next pose, waiting at most `timeout`; false if none came, also while connecting.
  [[nodiscard]] bool next(std::chrono::milliseconds timeout) {
    return check(ec_subscriber_next(subscriber_.get(), static_cast<int>(timeout.count()))) == EC_OK;
  }

  /// The current pose rebuilt with `detail` (0..1) of the vertices. Its arrays stay until the next call. REQUIRES:
  /// next() was true once.
  ec_surface surface(double detail = 1) {
    auto surface = EC_INIT(ec_surface);
    check(ec_subscriber_surface(subscriber_.get(), detail, &surface));
    return surface;
  }
  /// The same within a budget of vertices, see ec_subscriber_surface_within().
  ec_surface surface_within(std::uint32_t max_vertices) {
    auto surface = EC_INIT(ec_surface);
    check(ec_subscriber_surface_within(subscriber_.get(), max_vertices, &surface));
    return surface;
  }

  /// Shows what was at a time (negative: so long ago), see ec_subscriber_seek(); then next() throws once if the broker
  /// does not do it.
  void seek(std::chrono::microseconds at, double speed = 1) {
    check(ec_subscriber_seek(subscriber_.get(), at.count(), speed));
  }
  /// The pose after the current one, or before it, alone.
  void step(bool forward) { check(ec_subscriber_step(subscriber_.get(), forward ? 1 : 0)); }
  void live() { check(ec_subscriber_live(subscriber_.get())); }
  ec_past past() {
    auto past = EC_INIT(ec_past);
    check(ec_subscriber_get_past(subscriber_.get(), &past));
    return past;
  }

  ec_subscriber_stats stats() const {
    auto stats = EC_INIT(ec_subscriber_stats);
    check(ec_subscriber_get_stats(subscriber_.get(), &stats));
    return stats;
  }

 private:
  std::unique_ptr<ec_subscriber, void (*)(ec_subscriber*)> subscriber_;
};

}  // namespace eigencast
