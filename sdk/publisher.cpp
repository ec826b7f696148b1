// SPDX-License-Identifier: MIT
#include "sdk/publisher.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <optional>

#include "common/codec/recaller.h"
#include "common/core/text.h"
#include "common/net/clock_offset.h"
#include "common/wire/control.h"
#include "common/wire/limits.h"
#include "sdk/asset_uploader.h"
#include "sdk/broker.h"
#include "sdk/key_writer.h"
#include "sdk/pose_projection.h"
#include "sdk/send_policy.h"
#include "sdk/sender_memory.h"

namespace eigencast {

namespace {

using std::chrono::milliseconds;

constexpr milliseconds kUploadRetry{1000};
/// Another sender may have left by then.
constexpr milliseconds kRefusedRetry{5000};

Result<void> check_capture_time(TimeUs capture_us) {
  if (capture_us >= 0 && capture_us <= limits::kMaxTimeUs) return {};
  return fail(ErrorCode::kInvalidArgument,
              "capture time " + std::to_string(capture_us) + " us is out of range: it must be 0 to 2^62 - 1");
}

ErrorCode code_named(std::string_view name) {
  for (int code = 0; code < static_cast<int>(ErrorCode::kInternal); ++code) {
    if (name_of(static_cast<ErrorCode>(code)) == name) return static_cast<ErrorCode>(code);
  }
  return ErrorCode::kInternal;
}

class BrokerPublisher final : public Publisher {
 public:
  /// asset  null: of keys alone
  BrokerPublisher(PublisherOptions options, BrokerUrl url, CodecKind codec, StreamFormat format,
                  std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded, LogSink log)
      : options_(std::move(options)),
        url_(std::move(url)),
        asset_(std::move(asset)),
        encoded_(std::move(encoded)),
        log_(std::move(log)),
        format_(std::move(format)),
        quantiser_(asset_ && codec == CodecKind::kQuantised
                       ? quantiser_for_error(error_bound(options_, *asset_), asset_->area, asset_->rank)
                       : Quantiser{}),
        projection_(asset_, options_.velocities, format_.scalars.size()),
        writer_({codec, format_.rows, format_.channels, format_.band_ends}, quantiser_.half_spacing, rate_control()),
        memory_(writer_.layout(), keeper_options()) {
    if (asset_ && options_.still_heartbeat_us > 0)
      still_.emplace(kStillOverError * error_bound(options_, *asset_), options_.still_heartbeat_us);
    stats_.detail = "connecting to " + url_.origin();
  }

  void start() {
    WebSocketOptions socket;
    socket.url = url_;
    socket.url.prefix.clear();  // on_try() has it, as it may be found out later.
    // Room for one frame of the largest size beyond the bound that send_coefficients() keeps.
    socket.max_unsent_bytes = options_.max_unsent_bytes + (std::size_t{1} << 20);
    WebSocketEvents events;
    events.on_try = [this] {
      return url_.prefix + "/v1/publish/" + url_.stream + (url_.query.empty() ? "" : "?" + url_.query);
    };
    events.on_open = [this](const BrokerUrl& broker) { on_open(broker); };
    events.on_text = [this](std::string_view text) { on_text(text); };
    events.on_down = [this](const Error& why, milliseconds wait) { on_down(why, wait); };
    AssetUploader::Events upload;
    upload.on_progress = [this](std::uint64_t sent, std::uint64_t total) { on_progress(sent, total); };
    upload.on_done = [this](const Result<void>& done) { return on_uploaded(done); };
    upload.on_exception = [this](const std::string& what) { upload_failed(what); };
    const std::lock_guard lock(mutex_);
    asset_uploader_ = std::make_unique<AssetUploader>(encoded_, std::move(upload));
    socket_ = WebSocket::start(std::move(socket), std::move(events), log_);
  }

  ~BrokerPublisher() override {
    if (asset_uploader_) asset_uploader_->stop();
    if (segment_uploader_) segment_uploader_->stop();
    if (socket_) socket_->stop();
  }

  SendStatus send_key(Key key, TimeUs capture_us, ByteView coded, std::optional<std::uint32_t> phase) override {
    const TimeUs begun_us = steady_now_us();
    const std::lock_guard lock(mutex_);
    if (const auto early = send_blocker(capture_us)) return *early;
    return send_coded(writer_.code_as(std::move(key), coded, phase, capture_us), {begun_us, 0});
  }

  SendStatus send_coefficients(std::span<const double> C, TimeUs capture_us, std::span<const double> V) override {
    return send(C, V, {}, capture_us, {steady_now_us(), 0});
  }

  Result<SendStatus> send_pose(const VertexPose& pose, TimeUs capture_us) override {
    if (auto usable = check_capture_time(capture_us); !usable) return usable.error();
    const TimeUs begun_us = steady_now_us();
    const auto made = projection_.project(pose);
    if (!made) return made.error();
    return send(made->C, made->V, made->S, capture_us, {begun_us, steady_now_us()});
  }

  Result<void> remember(std::vector<CodedSegment> segments) override {
    const std::lock_guard lock(mutex_);
    memory_.decide_by_caller();
    return remember_now(std::move(segments));
  }

  MemoryState memory() const override {
    const std::lock_guard lock(mutex_);
    return memory_.state();
  }

  std::vector<double> as_received() const override {
    const std::lock_guard lock(mutex_);
    return writer_.positions_held();
  }

  Stats stats() const override {
    const std::lock_guard lock(mutex_);
    return stats_;
  }

 private:
  enum class Phase { kDown, kUpload, kAnnounced, kLive };

  /// When the work on a pose began, and when its coefficients were there; 0: they were given.
  struct Work {
    TimeUs begun_us = 0;
    TimeUs transformed_us = 0;
  };

  std::optional<RateControl> rate_control() const {
    if (!asset_ || options_.bitrate <= 0) return std::nullopt;
    return RateControl(options_.bitrate, quantiser_.half_spacing, static_cast<std::uint8_t>(format_.band_ends.size()));
  }

  /// V: empty, or velocities per second; S: r x scalars.
  SendStatus send(std::span<const double> C, std::span<const double> V, std::span<const double> S, TimeUs capture_us,
                  const Work& work) {
    const std::lock_guard lock(mutex_);
    if (V.empty() == options_.velocities)
      return unusable(fail(ErrorCode::kInvalidArgument, V.empty() ? "a pose without velocities, which were announced"
                                                                  : "velocities that were not announced"));
    if (S.size() != format_.rows * format_.scalars.size())
      return unusable(
          fail(ErrorCode::kInvalidArgument, "a pose without the scalars that were announced, or with more"));
    std::vector<double> all;
    if (format_.channels > 3) C = all = rows_in_format(format_, C, V, S);
    if (const auto early = send_blocker(capture_us)) return *early;
    auto key = key_from_coefficients(writer_.layout(), C, quantiser_.step);
    if (!key) return unusable(key.error());
    if (!writer_.held() || !still_) return send_next(std::move(*key), capture_us, work);
    return send_unless_still(std::move(*key), C, capture_us, work);
  }

  /// The gate stays as it was where a frame is not sent. REQUIRES: as send_next; a key was sent, and there is a gate.
  SendStatus send_unless_still(Key key, std::span<const double> C, TimeUs capture_us, const Work& work) {
    const StillGate before = *still_;
    const double distance = surface_distance(C, coefficients_from_key(writer_.layout(), *writer_.held()), asset_->area);
    switch (still_->next(distance, capture_us)) {
      case StillGate::Action::kSkip:
        ++stats_.frames_held;
        return SendStatus::kSent;
      case StillGate::Action::kHold: {
        const SendStatus held = send_next(*writer_.held(), capture_us, work);
        if (held != SendStatus::kSent) still_ = before;
        return held;
      }
      case StillGate::Action::kResume:
        if (const auto held = send_next(*writer_.held(), still_->held_until_us(), work); held != SendStatus::kSent) {
          still_ = before;
          return held;
        }
        [[fallthrough]];
      case StillGate::Action::kSend:
        break;
    }
    return send_next(std::move(key), capture_us, work);
  }

  /// REQUIRES: mutex_ is held, nothing blocks sending.
  SendStatus send_next(Key key, TimeUs capture_us, const Work& work) {
    if (!memory_.decides()) return send_coded(writer_.code(std::move(key), capture_us), work);
    auto coded = writer_.code(key, capture_us);
    return send_coded(std::move(coded), work, &key);
  }

  /// Counted. REQUIRES: mutex_ is held.
  std::optional<SendStatus> send_blocker(TimeUs capture_us) {
    if (stats_.state != State::kLive) return dropped(DropReason::kDisconnected);
    if (socket_->unsent_bytes() > options_.max_unsent_bytes) return dropped(DropReason::kBehind);
    if (auto usable = check_capture_time(capture_us); !usable) return unusable(usable.error());
    if (!writer_.may_follow(capture_us)) return dropped(DropReason::kTime);
    return std::nullopt;
  }

  /// pose  to remember; may be null.  REQUIRES: as send_next.
  SendStatus send_coded(Result<KeyWriter::Coded> coded, const Work& work, const Key* pose = nullptr) {
    if (!coded) return unusable(coded.error());
    const std::size_t bytes = coded->message.size();
    const bool recalled = coded->next.phase.has_value();
    // Before it is handed over: the broker may have it before the call returns.
    const TimeUs sent_us = steady_now_us();
    const SendStatus status = socket_->send_binary(std::move(coded->message));
    if (status != SendStatus::kSent)
      return dropped(status == SendStatus::kDisconnected ? DropReason::kDisconnected : DropReason::kBehind);
    if (pose != nullptr && writer_.state() != nullptr) keep(*pose, *coded, bytes);
    writer_.sent(*std::move(coded), bytes);
    ++stats_.frames_sent;
    if (recalled) ++stats_.frames_recalled;
    stats_.payload_bytes += bytes;
    if (trace_every_ != 0) trace(work, sent_us);
    return status;
  }

  // The memory of poses. All but the callback REQUIRE: mutex_ is held.

  std::optional<MemoryKeeper::Options> keeper_options() const {
    if (!asset_ || options_.memory == MemoryUse::kOff || writer_.layout().is_float()) return std::nullopt;
    return MemoryKeeper::Options{writer_.layout(), encoded_->manifest.id.digest, options_.bitrate,
                                 options_.memory == MemoryUse::kOn};
  }

  /// REQUIRES: the key has left; a key before it.
  void keep(const Key& pose, const KeyWriter::Coded& coded, std::size_t bytes) {
    const bool due = memory_.add(
        {*writer_.state(), pose, bytes, coded.next.phase, writer_.half_spacing(), coded.capture_us, memory_.may_grow()},
        steady_now_us());
    stats_.saved_bytes = memory_.saved_bytes();
    if (memory_.state().generation != 0) stats_.memory_bytes = memory_.bytes();
    if (!due) return;
    if (auto asked = remember_now(memory_.segments_to_keep()); !asked) refuse_memory(asked.error());
  }

  Result<void> remember_now(std::vector<CodedSegment> segments) {
    if (auto wanted = memory_.want(std::move(segments)); !wanted) return wanted;
    if (phase_ == Phase::kLive) upload_memory();
    return {};
  }

  /// The broker has nothing of it (any more).
  void forget_memory() {
    if (segment_uploader_) segment_uploader_->cancel();
    writer_.code_by({}, {}, false);
    memory_.forget();
  }

  void upload_memory() {
    auto objects = std::make_shared<EncodedAsset>();
    objects->chunks = memory_.missing();
    if (!segment_uploader_) {
      AssetUploader::Events upload;
      upload.on_progress = [](std::uint64_t, std::uint64_t) {};
      upload.on_done = [this](const Result<void>& done) {
        on_memory_uploaded(done);
        return std::optional<milliseconds>();
      };
      upload.on_exception = [this](const std::string& what) { on_memory_uploaded(fail(ErrorCode::kInternal, what)); };
      segment_uploader_ = std::make_unique<AssetUploader>(objects, std::move(upload));
    }
    segment_uploader_->use(std::move(objects));
    segment_uploader_->begin(at_, milliseconds(0));
  }

  void on_memory_uploaded(const Result<void>& done) {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kLive || !memory_.state().pending) return;
    if (!done) return refuse_memory(done.error());
    if (socket_->send_text(text_from_control(memory_.message(url_.stream))) != SendStatus::kSent)
      return refuse_memory(fail(ErrorCode::kDisconnected, "the broker takes no messages now"));
    if (memory_.asked()) writer_.code_by({}, {}, false);
  }

  void refuse_memory(const Error& why) {
    memory_.refuse(why, steady_now_us());
    log(log_, why.code == ErrorCode::kUnsupported ? LogLevel::kInfo : LogLevel::kWarning,
        "memory not used: " + why.message);
  }

  SendStatus dropped(DropReason why) {
    ++stats_.frames_dropped;
    ++stats_.dropped_for[static_cast<std::size_t>(why)];
    return why == DropReason::kDisconnected ? SendStatus::kDisconnected : SendStatus::kDropped;
  }

  SendStatus unusable(const Error& why) {
    if (stats_.detail != why.message) log(log_, LogLevel::kError, "frame not sent: " + why.message);
    stats_.detail = why.message;
    return dropped(DropReason::kUnusable);
  }

  /// Where timing marks were asked for. Lost traces are not resent. REQUIRES: mutex_ is held.
  void trace(const Work& work, TimeUs sent_us) {
    const TimeUs now = steady_now_us();
    if (writer_.sequence() % trace_every_ == 0) {
      control::Trace m;
      m.stream_id = writer_.stream_id();
      m.epoch = writer_.epoch();
      m.sequence = writer_.sequence();
      m.stages.emplace_back(control::stage::kStarted, work.begun_us);
      if (work.transformed_us != 0) m.stages.emplace_back(control::stage::kTransformed, work.transformed_us);
      m.stages.emplace_back(control::stage::kSent, sent_us);
      if (const auto clock = clock_.estimate()) m.broker_clock = {clock->offset_us, clock->error_us};
      (void)socket_->send_text(text_from_control(m));
    }
    if (now - last_ping_us_ < kPingIntervalUs) return;
    last_ping_us_ = now;
    (void)socket_->send_text(text_from_control(control::Ping{++ping_id_, now}));
  }

  // Runs on the connection's thread.

  void on_open(const BrokerUrl& broker) {
    const std::lock_guard lock(mutex_);
    trace_every_ = 0;
    clock_.reset();  // It may be another broker.
    if (ever_open_) ++stats_.reconnects;
    ever_open_ = true;
    phase_ = Phase::kUpload;
    stats_.state = State::kUploading;
    at_ = broker;
    at_.prefix = url_.prefix;
    stats_.detail = "connected to " + at_.origin();
    asset_uploader_->begin(at_, milliseconds(0));
    if (const std::string line = retries_.succeeded(); !line.empty()) log(log_, LogLevel::kInfo, line);
  }

  void on_down(const Error& why, milliseconds wait) {
    std::unique_lock lock(mutex_);
    phase_ = Phase::kDown;
    writer_.restart();
    forget_memory();
    stats_.subscribers = 0;
    stats_.gave_up = wait.count() == 0;
    stats_.state = why.code == ErrorCode::kRefused || wait.count() == 0 ? State::kRefused : State::kConnecting;
    stats_.detail = why.message + try_again_in(wait);
    asset_uploader_->cancel();
    lock.unlock();
    if (const std::string line = retries_.failed(why.message); !line.empty())
      log(log_, LogLevel::kWarning, line + try_again_in(wait));
    if (why.code != ErrorCode::kRefused || ever_open_) return;
    if (auto found = located(url_)) {
      lock.lock();
      url_ = std::move(*found);
      socket_->retry_now();
    }
  }

  void on_text(std::string_view text) {
    if (const auto message = read_control(text, log_)) std::visit([this](const auto& m) { on_message(m); }, *message);
  }

  template <typename Message>
  void on_message(const Message&) {}  // What concerns subscribers only.

  void on_message(const control::Announced& m) {
    std::unique_lock lock(mutex_);
    if (phase_ != Phase::kAnnounced) return;
    phase_ = Phase::kLive;
    resume_ = m.resume;
    writer_.begin(m);
    forget_memory();
    if (memory_.state().pending) upload_memory();
    if (still_) still_->restart();
    stats_.state = State::kLive;
    const std::string live = stats_.detail = "live at " + at_.origin() + url_.prefix + "/" + url_.stream;
    lock.unlock();
    log(log_, LogLevel::kInfo, live + ", epoch " + std::to_string(m.epoch));
  }

  void on_message(const control::Remembered& m) {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kLive || !memory_.awaits(m.generation)) return;
    if (!m.code.empty()) return refuse_memory({code_named(m.code), m.message});
    const auto poses = memory_.hold();
    if (!poses) return;
    log(log_, LogLevel::kInfo, "keys are predicted from a memory of " + std::to_string(poses->pose_count()) + " poses");
    const auto recaller = std::make_shared<Recaller>(*poses);
    const auto coder = [recaller](const ChainState& state, const Key& key, std::uint8_t half_spacing) {
      return recaller->encode(state, key, half_spacing);
    };
    writer_.code_by(coder, *poses, true);
  }

  void on_message(const control::Subscribers& m) {
    const std::lock_guard lock(mutex_);
    stats_.subscribers = m.count;
  }

  void on_message(const control::Ping& m) {
    const std::lock_guard lock(mutex_);
    (void)socket_->send_text(text_from_control(control::Pong{m.id, m.time_us, steady_now_us()}));
  }

  void on_message(const control::Pong& m) {
    const std::lock_guard lock(mutex_);
    clock_.add(m.time_us, m.peer_time_us, steady_now_us());
  }

  void on_message(const control::TraceRequest& m) {
    const std::lock_guard lock(mutex_);
    trace_every_ = m.every;
  }

  void on_message(const control::ErrorMessage& m) {
    const bool lacks_asset = m.code == name_of(ErrorCode::kNotFound);
    const std::string text = "the broker says: " + m.message + " (" + m.code + ")";
    std::unique_lock lock(mutex_);
    stats_.detail = text;
    if (phase_ == Phase::kAnnounced || phase_ == Phase::kLive) {
      writer_.restart();
      phase_ = Phase::kUpload;
      stats_.state = lacks_asset ? State::kUploading : State::kRefused;
      asset_uploader_->begin(at_, lacks_asset ? kUploadRetry : kRefusedRetry);
    }
    lock.unlock();
    log(log_, LogLevel::kError, text);
  }

  void on_message(const control::Notice& m) { log(log_, LogLevel::kInfo, m.message); }

  void on_message(const control::Bye& m) {
    std::unique_lock lock(mutex_);
    socket_->hold_off(milliseconds(m.retry_after_ms));
    lock.unlock();
    log(log_, LogLevel::kInfo, "the broker leaves: " + m.reason);
  }

  // On the uploader's thread, whenever a connection is new.

  void on_progress(std::uint64_t sent, std::uint64_t total) {
    const std::lock_guard lock(mutex_);
    stats_.detail =
        formatted("uploading %.1f of %.1f MB", static_cast<double>(sent) / 1e6, static_cast<double>(total) / 1e6);
  }

  std::optional<milliseconds> on_uploaded(const Result<void>& done) {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kUpload) return std::nullopt;
    if (!done) {
      const bool refused = done.error().code == ErrorCode::kRefused;
      const milliseconds wait = refused ? kRefusedRetry : kUploadRetry;
      stats_.state = refused ? State::kRefused : State::kUploading;
      stats_.detail = done.error().message + try_again_in(wait);
      log(log_, LogLevel::kWarning, stats_.detail);
      return wait;
    }
    control::Announce m;
    m.asset = encoded_->manifest.id.hex();
    m.format = format_;
    m.key_rate_hz = options_.key_rate_hz;
    m.world = options_.world;
    m.resume = resume_;
    phase_ = Phase::kAnnounced;
    stats_.detail = "announced, waiting for the broker";
    // A connection that broke meanwhile says so by on_down, and everything starts again.
    (void)socket_->send_text(text_from_control(m));
    return std::nullopt;
  }

  void upload_failed(const std::string& what) {
    std::unique_lock lock(mutex_);
    if (phase_ == Phase::kAnnounced) phase_ = Phase::kUpload;
    stats_.detail = what + try_again_in(kUploadRetry);
    if (phase_ == Phase::kUpload) asset_uploader_->begin(at_, kUploadRetry);
    lock.unlock();
    log(log_, LogLevel::kError, what);
  }

  const PublisherOptions options_;
  BrokerUrl url_;  ///< Changed by the connection's thread alone, with mutex_, before it is ever open.
  const std::shared_ptr<const Asset> asset_;
  const std::shared_ptr<const EncodedAsset> encoded_;
  const LogSink log_;
  const StreamFormat format_;
  const Quantiser quantiser_;
  PoseProjection projection_;  ///< For the caller's thread alone.

  RetryLog retries_;  ///< For the connection's thread alone.

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_):
  std::unique_ptr<WebSocket> socket_;              ///< Set once by start().
  std::unique_ptr<AssetUploader> asset_uploader_;  ///< Likewise.
  Phase phase_ = Phase::kDown;
  std::string resume_;  ///< Takes the stream over, at this broker and at others.
  BrokerUrl at_;        ///< The broker that it is or was connected to.
  bool ever_open_ = false;
  KeyWriter writer_;
  std::optional<StillGate> still_;  ///< Where still surfaces are not to be sent again and again.
  SenderMemory memory_;
  std::unique_ptr<AssetUploader> segment_uploader_;  ///< Once there was something to upload.
  Stats stats_;
  std::uint32_t trace_every_ = 0;  ///< Keys of which the broker wants traces; 0: none.
  ClockOffset clock_;              ///< The broker's; learnt while there are traces.
  TimeUs last_ping_us_ = 0;
  std::uint64_t ping_id_ = 0;
};

template <typename... Arguments>
std::unique_ptr<Publisher> started(Arguments&&... arguments) {
  auto made = std::make_unique<BrokerPublisher>(std::forward<Arguments>(arguments)...);
  made->start();
  return made;
}

/// Also of what this surface does not do with.
Result<void> check_options(const PublisherOptions& options, const Asset& asset) {
  if (auto usable = check_options(options); !usable) return usable;
  if (options.error == 0 && !(asset.diagonal() > 0))
    return fail(ErrorCode::kInvalidArgument,
                "the rest pose has no extent, so the error bound has no default: give one");
  return {};
}

}  // namespace

Result<void> check_options(const PublisherOptions& options) {
  if (!std::isfinite(options.error) || options.error < 0)
    return fail(ErrorCode::kInvalidArgument,
                "the error bound must be a positive length in model units, or 0 for the default");
  if (!std::isfinite(options.bitrate) || options.bitrate < 0 || options.still_heartbeat_us < 0)
    return fail(ErrorCode::kInvalidArgument, "bit rate and heartbeat must be positive, or 0 for none");
  if (options.scalars.size() > kMaxScalars)
    return fail(ErrorCode::kInvalidArgument, "a stream carries at most " + std::to_string(kMaxScalars) + " scalars");
  if (!options.scalars.empty() && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of scalars cannot leave out still poses: they may change while the surface stands still");
  if (options.velocities && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of velocities cannot leave out still poses: a held pose would go on with its velocities");
  if (options.bitrate > 0 && options.codec != CodecKind::kQuantised)
    return fail(ErrorCode::kInvalidArgument, "only the quantised codec can keep to a bit rate");
  return {};
}

Result<std::unique_ptr<Publisher>> Publisher::create(PublisherOptions options, std::shared_ptr<const Asset> asset,
                                                     std::shared_ptr<const EncodedAsset> encoded, LogSink log) {
  if (!asset || !encoded || !asset->complete())
    return fail(ErrorCode::kInvalidArgument, "a publisher needs a complete asset");
  auto url = stream_url(options.url, options.credentials, log);
  if (!url) return url.error();
  if (auto usable = check_options(options, *asset); !usable) return usable.error();
  StreamFormat format = format_of(options, *asset);
  if (auto usable = check_format(format); !usable) return usable.error();
  const CodecKind codec = options.codec;
  return started(std::move(options), std::move(*url), codec, std::move(format), std::move(asset), std::move(encoded),
                 std::move(log));
}

Result<std::unique_ptr<Publisher>> Publisher::create_for_keys(PublisherOptions options, const StreamFormat& format,
                                                              std::shared_ptr<const EncodedAsset> encoded,
                                                              LogSink log) {
  if (!encoded) return fail(ErrorCode::kInvalidArgument, "a publisher needs to know its asset");
  if (auto usable = check_format(format); !usable) return usable.error();
  const auto codec = codec_from_name(format.codec);
  if (!codec) return codec.error();
  auto url = stream_url(options.url, options.credentials, log);
  if (!url) return url.error();
  return started(std::move(options), std::move(*url), *codec, format, nullptr, std::move(encoded), std::move(log));
}

}  // namespace eigencast
