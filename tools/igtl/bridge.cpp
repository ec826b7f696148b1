// SPDX-License-Identifier: MIT
#include "tools/igtl/bridge.h"

#include <eigencast/eigencast.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "common/core/clock.h"
#include "tools/igtl/messages.h"

namespace eigencast::igtl {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kIdle{10}, kBusy{1};
constexpr TimeUs kReportUs = 1'000'000;
/// A sender's clock that runs off by so much is another one.
constexpr TimeUs kClockJumpUs = 10'000'000;

/// Of a scalar, as far as it is known.
struct Range {
  std::string name;
  double low = 0, high = 0;
  double span() const { return high - low; }
};
/// By how much a scalar outgrows its range before the stream is made anew.
constexpr double kRangeGrowth = 16;

using StreamHandle = std::unique_ptr<ec_stream, decltype(&ec_stream_release)>;
using SubscriberHandle = std::unique_ptr<ec_subscriber, decltype(&ec_subscriber_release)>;

Error failure(ec_status status) {
  const bool usage = status == EC_INVALID_ARGUMENT || status == EC_NOT_FOUND;
  return fail(usage ? ErrorCode::kInvalidArgument : ErrorCode::kRefused, ec_last_error());
}

/// Points into `own`.
template <typename COptions>
void give_credentials(const Credentials& own, COptions& options) {
  options.token = own.token.c_str();
  options.ca_file = own.ca_file.c_str();
  options.certificate_file = own.certificate_file.c_str();
  options.key_file = own.key_file.c_str();
  options.insecure = own.insecure ? 1 : 0;
}

/// POLYDATA of peers to a stream.
class Publishing {
 public:
  Publishing(const Options& options, const LogSink& log) : options_(options), log_(log), device_(options.device) {}

  /// Makes the stream, or makes it anew for surfaces with these scalars.
  Result<void> begin(const std::vector<Range>& scalars) {
    std::vector<ec_scalar> infos;
    for (const auto& [name, low, high] : scalars) infos.push_back({name.c_str(), "", low, high, 0});
    auto bake = EC_INIT(ec_bake_options);
    bake.rank = options_.rank;
    bake.name = device_.c_str();
    auto publisher = EC_INIT(ec_publisher_options);
    publisher.error = options_.error;
    publisher.scalars = static_cast<std::uint32_t>(infos.size());
    publisher.scalar_info = infos.data();
    give_credentials(options_.credentials, publisher);
    auto options = EC_INIT(ec_stream_options);
    options.bake = &bake;
    options.publisher = &publisher;
    options.up = options_.z_up ? "z" : "y";
    options.scale = options_.scale;
    options.max_rate_hz = options_.max_rate_hz;
    stream_.reset();  // its name is free then
    ec_stream* made = nullptr;
    if (const ec_status status = ec_stream_create(options_.url.c_str(), &options, &made); status < 0)
      return failure(status);
    stream_.reset(made);
    scalars_ = scalars;
    return {};
  }

  /// False: where the next message begins is not known.
  bool take(std::uint64_t peer, ByteView bytes) {
    if (peer != peer_) {
      peer_ = peer;
      reader_ = {};
      first_time_s_.reset();
    }
    const auto taken = reader_.take(bytes, [this](const Header& header, ByteView body) {
      if (const auto sent = send(header, body); !sent) refuse(sent.error());
    });
    if (!taken) refuse(taken.error());
    return taken.has_value();
  }

  /// Says what changed, at most once a second.
  void report(TimeUs now) {
    if (sent_ == 0 || now - reported_us_ < kReportUs) return;
    reported_us_ = now;
    const std::string detail = stats().detail;
    if (detail != detail_) log(log_, LogLevel::kInfo, detail);
    detail_ = detail;
  }

  void summarise() const {
    const ec_stream_stats now = stats();
    const auto number = [](std::uint64_t n) { return std::to_string(n); };
    log(log_, LogLevel::kInfo,
        number(sent_) + " surfaces taken, " + number(refused_) + " refused, " + number(others_) +
            " of other devices; of the present stream " + number(now.poses_sent) + " sent, " + number(now.poses_early) +
            " too fast, " + number(now.poses_superseded) + " before it was live, " + number(now.poses_dropped) +
            " dropped");
  }

 private:
  ec_stream_stats stats() const {
    auto now = EC_INIT(ec_stream_stats);
    now.detail = "";
    (void)ec_stream_get_stats(stream_.get(), &now);
    return now;
  }

  Result<void> send(const Header& header, ByteView body) {
    if (device_.empty()) device_ = header.device;
    if (header.device != device_) {
      if (others_++ == 0)
        log(log_, LogLevel::kWarning,
            "'" + header.device + "' is not streamed: '" + device_ + "' is; --device chooses, a bridge each");
      return {};
    }
    const auto content = content_from_body(header, body);
    if (!content) return content.error();
    const auto data = polydata_from_content(*content);
    if (!data) return data.error();
    for (const auto& [name, values] : data->scalars)
      if (!std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); }))
        return fail(ErrorCode::kInvalidArgument, "a value of the scalar '" + name + "' is not finite");
    if (const auto scalars = ranges_with(data->scalars); !scalars_hold(scalars) || !stream_)
      if (const auto begun = begin(scalars); !begun) return begun.error();
    return send(header, *data);
  }

  /// Those of now, with those before where they are of the same names.
  std::vector<Range> ranges_with(const std::vector<PolyData::Scalar>& scalars) const {
    std::vector<Range> ranges;
    for (const auto& [name, values] : scalars) {
      const auto [low, high] = std::minmax_element(values.begin(), values.end());
      ranges.push_back({name, *low, *high});
      for (const Range& known : scalars_)
        if (known.name == name)
          ranges.back() = {name, std::min(known.low, double{*low}), std::max(known.high, double{*high})};
      if (!(ranges.back().span() > 0)) ranges.back().high = ranges.back().low + std::max(1e-6, std::abs(*low) * 1e-3);
    }
    return ranges;
  }

  /// A stream's range says how fine it codes a scalar: values may leave it, but not by far.
  bool scalars_hold(const std::vector<Range>& now) const {
    return std::equal(now.begin(), now.end(), scalars_.begin(), scalars_.end(), [](const Range& a, const Range& b) {
      return a.name == b.name && a.span() <= kRangeGrowth * b.span();
    });
  }

  Result<void> send(const Header& header, const PolyData& data) {
    static constexpr std::uint32_t kNone = 0;  // A point cloud's corners are none; a null would be those of before.
    const std::size_t points = data.points.size() / 3, scalars = data.scalars.size();
    std::vector<float> values(points * scalars);
    for (std::size_t s = 0; s < scalars; ++s)
      for (std::size_t i = 0; i < points; ++i) values[i * scalars + s] = data.scalars[s].values[i];
    auto frame = EC_INIT(ec_frame);
    frame.points = data.points.data();
    frame.point_count = static_cast<std::uint32_t>(points);
    frame.corners = data.corners.empty() ? &kNone : data.corners.data();
    frame.corner_count = data.corners.size();
    frame.offsets = data.offsets.empty() ? nullptr : data.offsets.data();
    frame.offset_count = data.offsets.size();
    frame.scalars = values.empty() ? nullptr : values.data();
    double time_s = 0;
    if (header.timestamp != 0) {
      if (!first_time_s_) first_time_s_ = header.time_s();
      time_s = std::clamp(header.time_s() - *first_time_s_, -1e8, 1e8);
      frame.time_s = &time_s;
    }
    if (const ec_status status = ec_stream_send(stream_.get(), &frame); status < 0) return failure(status);
    ++sent_;
    return {};
  }

  void refuse(const Error& error) {
    ++refused_;
    log(log_, LogLevel::kWarning, error.message);
  }

  const Options& options_;
  const LogSink& log_;
  std::string device_;
  StreamHandle stream_{nullptr, ec_stream_release};
  std::vector<Range> scalars_;  ///< As the stream announces them.
  MessageReader reader_;
  std::uint64_t peer_ = 0, sent_ = 0, refused_ = 0, others_ = 0;
  std::optional<double> first_time_s_;
  TimeUs reported_us_ = 0;
  std::string detail_;
};

/// A stream to POLYDATA.
class Watching {
 public:
  Watching(const Options& options, const LogSink& log) : options_(options), log_(log) {}

  Result<void> begin() {
    auto options = EC_INIT(ec_subscriber_options);
    give_credentials(options_.credentials, options);
    ec_subscriber* made = nullptr;
    if (const ec_status status = ec_subscriber_create(options_.url.c_str(), &options, &made); status < 0)
      return failure(status);
    subscriber_.reset(made);
    return {};
  }

  /// The next pose, as the rate has room for it.
  void step(Peers& peers) {
    const Peers::Stats now = peers.stats();
    if (now.peers != peers_) pending_ = has_pose_;  // A newcomer gets what is there.
    peers_ = now.peers;
    const auto wait = now.writing || pending_ ? kBusy : kIdle;
    if (ec_subscriber_next(subscriber_.get(), static_cast<int>(wait.count())) == EC_OK) {
      early_ += pending_ && now.connected > 0 ? 1 : 0;
      pending_ = has_pose_ = true;
    }
    report();
    if (!pending_ || now.connected == 0 || !has_turn()) return;
    pending_ = false;
    auto surface = EC_INIT(ec_surface);
    if (ec_subscriber_surface(subscriber_.get(), 1, &surface) < 0) return;  // Another surface is on its way.
    ++made_;
    peers.offer(std::make_shared<const Bytes>(
        message_from_polydata(polydata_of(surface), options_.device, options_.version, timestamp(surface.capture_us))));
  }

  void summarise(const Peers::Stats& peers) const {
    const auto number = [](std::uint64_t n) { return std::to_string(n); };
    log(log_, LogLevel::kInfo,
        number(made_) + " surfaces, " + number(early_) + " more were too fast; " + number(peers.sent) +
            " messages sent, " + number(peers.superseded) + " replaced by newer ones");
  }

 private:
  static constexpr double kBurst = 4;  ///< Poses that may come together: senders are never quite even.

  bool has_turn() {
    const TimeUs now = steady_now_us();
    tokens_ = std::min(kBurst, tokens_ + 1e-6 * static_cast<double>(now - turn_us_) * options_.max_rate_hz);
    turn_us_ = now;
    if (tokens_ < 1) return false;
    --tokens_;
    return true;
  }

  /// In the sender's order of vertices, once the surface is whole; before, as far as it is there.
  PolyData polydata_of(const ec_surface& surface) const {
    const std::uint32_t n = surface.vertex_count;
    const bool whole = std::all_of(surface.source_vertex, surface.source_vertex + n, [n](auto v) { return v < n; });
    const auto index = [&](std::uint32_t i) { return whole ? surface.source_vertex[i] : i; };
    const float scale = static_cast<float>(1 / options_.scale);
    PolyData data;
    data.points.resize(std::size_t{3} * n);
    for (std::uint32_t i = 0; i < n; ++i) {
      const float* from = surface.positions + std::size_t{3} * i;
      float* to = data.points.data() + std::size_t{3} * index(i);
      to[0] = scale * from[0];
      to[1] = scale * (options_.z_up ? -from[2] : from[1]);
      to[2] = scale * (options_.z_up ? from[1] : from[2]);
    }
    data.corners.resize(std::size_t{3} * surface.triangle_count);
    for (std::size_t i = 0; i < data.corners.size(); ++i) data.corners[i] = index(surface.triangles[i]);
    for (std::uint32_t s = 0; s < surface.scalar_count; ++s) {
      const char* name = surface.scalar_info != nullptr ? surface.scalar_info[s].name : "";
      data.scalars.push_back({*name != 0 ? name : "scalar " + std::to_string(s + 1), std::vector<float>(n)});
      for (std::uint32_t i = 0; i < n; ++i)
        data.scalars.back().values[index(i)] = surface.scalars[std::size_t{i} * surface.scalar_count + s];
    }
    return data;
  }

  /// Since 1970. Senders' clocks begin anywhere: the pose that came quickest so far came at once.
  std::uint64_t timestamp(TimeUs capture_us) {
    using namespace std::chrono;
    const TimeUs wall = duration_cast<microseconds>(system_clock::now().time_since_epoch()).count();
    const TimeUs offset = wall - capture_us;
    if (offset < offset_us_ || offset - offset_us_ > kClockJumpUs) offset_us_ = offset;
    const auto at = static_cast<std::uint64_t>(std::max<TimeUs>(0, capture_us + offset_us_));
    return (at / 1'000'000 << 32) | ((at % 1'000'000) << 32) / 1'000'000;
  }

  void report() {
    const TimeUs now = steady_now_us();
    if (now - reported_us_ < kReportUs) return;
    reported_us_ = now;
    auto stats = EC_INIT(ec_subscriber_stats);
    if (ec_subscriber_get_stats(subscriber_.get(), &stats) < 0 || (stats.live != 0) == live_) return;
    live_ = stats.live != 0;
    log(log_, LogLevel::kInfo, options_.url + (live_ ? " is live" : " is not live any more"));
  }

  const Options& options_;
  const LogSink& log_;
  SubscriberHandle subscriber_{nullptr, ec_subscriber_release};
  bool pending_ = false, has_pose_ = false, live_ = false;
  std::uint64_t peers_ = 0, made_ = 0, early_ = 0;
  double tokens_ = kBurst;
  TimeUs turn_us_ = steady_now_us(), reported_us_ = 0;
  TimeUs offset_us_ = std::numeric_limits<TimeUs>::max();
};

Result<void> publish(const Options& options, const std::atomic<bool>& stop, const LogSink& log) {
  Publishing publishing(options, log);
  if (const auto begun = publishing.begin({}); !begun) return begun.error();
  const auto peers = Peers::create(options.peers, log);
  if (!peers) return peers.error();
  while (!stop) {
    (*peers)->poll(kIdle, [&](std::uint64_t peer, ByteView bytes) { return publishing.take(peer, bytes); });
    publishing.report(steady_now_us());
  }
  publishing.summarise();
  return {};
}

Result<void> watch(const Options& options, const std::atomic<bool>& stop, const LogSink& log) {
  Watching watching(options, log);
  if (const auto begun = watching.begin(); !begun) return begun.error();
  const auto peers = Peers::create(options.peers, log);
  if (!peers) return peers.error();
  while (!stop) {
    (*peers)->poll(milliseconds(0), [](std::uint64_t, ByteView) { return true; });  // What they send is not for us.
    watching.step(**peers);
  }
  watching.summarise((*peers)->stats());
  return {};
}

}  // namespace

Result<void> run_bridge(const Options& options, const std::atomic<bool>& stop, const LogSink& log) {
  return options.publishes ? publish(options, stop, log) : watch(options, stop, log);
}

}  // namespace eigencast::igtl
