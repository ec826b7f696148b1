// SPDX-License-Identifier: MIT
#include "sdk/publisher.h"

#include <algorithm>
#include <atomic>
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
#include "sdk/send_policy.h"
#include "sdk/sending.h"
#include "sdk/stream_learner.h"

namespace eigencast {

namespace {

using std::chrono::milliseconds;

constexpr milliseconds kUploadRetry{1000};
/// Another sender may have left by then.
constexpr milliseconds kRefusedRetry{5000};
constexpr TimeUs kProgressEveryUs = 1'000'000;

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
  BrokerPublisher(PublisherOptions options, BrokerUrl url, std::unique_ptr<Sending> sending, LogSink log)
      : options_(std::move(options)), url_(std::move(url)), log_(std::move(log)), now_(std::move(sending)) {
    BrokerPublisher::learn(options_.learn);
    restart_still();
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
    asset_uploader_ = std::make_unique<AssetUploader>(now_->encoded, std::move(upload));
    socket_ = WebSocket::start(std::move(socket), std::move(events), log_);
  }

  ~BrokerPublisher() override {
    learner_.reset();
    if (asset_uploader_) asset_uploader_->stop();
    if (change_uploader_) change_uploader_->stop();
    if (segment_uploader_) segment_uploader_->stop();
    if (socket_) socket_->stop();
  }

  SendStatus send_key(Key key, TimeUs capture_us, ByteView coded, std::optional<std::uint32_t> phase) override {
    const TimeUs begun_us = steady_now_us();
    const std::lock_guard lock(mutex_);
    if (const auto early = send_blocker(capture_us)) return *early;
    return send_coded(now_->writer.code_as(std::move(key), coded, phase, capture_us), {begun_us, 0});
  }

  SendStatus send_coefficients(std::span<const double> C, TimeUs capture_us, std::span<const double> V) override {
    return send(C, V, {}, capture_us, {steady_now_us(), 0});
  }

  Result<SendStatus> send_pose(const VertexPose& pose, TimeUs capture_us) override {
    (void)take_change();
    if (auto usable = check_capture_time(capture_us); !usable) return usable.error();
    const TimeUs begun_us = steady_now_us();
    const auto made = now_->projection.project(pose);
    if (!made) return made.error();
    learn_from(pose, made->C, capture_us);
    return send(made->C, made->V, made->S, capture_us, {begun_us, steady_now_us()});
  }

  Result<void> change_to(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded,
                         double coarser) override {
    const std::shared_ptr<const Asset> before = this->asset();
    if (!before || !asset || !encoded || !asset->complete())
      return fail(ErrorCode::kInvalidArgument, "a publisher of poses changes to a complete asset");
    StreamFormat format = format_of(options_, *asset);
    if (auto usable = check_format(format); !usable) return usable;
    Change change{nullptr, Ramp(*before, *asset)};
    if (change.ramp.is_over())
      return fail(ErrorCode::kInvalidArgument,
                  "a stream changes to an asset of the same surface, whose vertices are in the same order");
    change.to = std::make_unique<Sending>(options_, options_.codec, std::move(format), std::move(asset),
                                          std::move(encoded), coarser);
    if (auto ready = change.to->projection.prepare(); !ready) return ready;
    const std::lock_guard lock(mutex_);
    change_ = std::move(change);
    if (phase_ == Phase::kLive) upload_change();
    return {};
  }

  bool take_change() override {
    const std::lock_guard lock(mutex_);
    const bool begins_anew = phase_ == Phase::kDown;
    if (!change_ || (!begins_anew && !change_->granted)) return false;
    if (segment_uploader_) segment_uploader_->cancel();
    Sending& to = *change_->to;
    const bool alike = to.format.scalars == now_->format.scalars && to.format.velocity_us == now_->format.velocity_us;
    ramp_.reset();
    if (!begins_anew) {
      std::optional<Key> held;
      if (alike && now_->writer.held() != nullptr) {
        const auto C = coefficients_from_key(now_->writer.layout(), *now_->writer.held());
        if (auto key = key_from_coefficients(to.writer.layout(), change_->ramp.carried_over(C, to.format.channels),
                                             to.quantiser.step))
          held = std::move(*key);
        ramp_ = std::move(change_->ramp);
      }
      to.writer.continue_as(*change_->granted, now_->writer.newest(), std::move(held));
      resume_ = change_->granted->resume;
    }
    stats_.learnt_columns = stats_.learnt_bytes = 0;
    for (const AssetObject& section : to.encoded->sections) {
      stats_.learnt_columns = to.asset->rank - now_->asset->rank;
      stats_.learnt_bytes += section.bytes.size() + to.encoded->manifest.bytes.size();
      learn_ = LearnUse::kOff;
    }
    saved_before_ = stats_.saved_bytes;
    memory_before_ = stats_.memory_bytes;
    now_ = std::move(change_->to);
    change_.reset();
    asset_uploader_->use(now_->encoded);
    restart_still();
    ++stats_.changes;
    return true;
  }

  void learn(LearnUse use) override {
    const std::lock_guard lock(mutex_);
    learn_ = now_->writer.layout().is_float() ? LearnUse::kOff : use;
  }

  void show_progress(double fraction) override {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kLive || change_ || steady_now_us() - progress_us_ < kProgressEveryUs) return;
    progress_us_ = steady_now_us();
    (void)socket_->send_text(text_from_control(control::Progress{url_.stream, std::clamp(fraction, 0.0, 1.0)}));
  }

  std::shared_ptr<const Asset> asset() const override {
    const std::lock_guard lock(mutex_);
    return now_->asset;
  }

  Result<void> remember(std::vector<CodedSegment> segments) override {
    const std::lock_guard lock(mutex_);
    now_->memory.decide_by_caller();
    return remember_now(std::move(segments));
  }

  MemoryState memory() const override {
    const std::lock_guard lock(mutex_);
    return now_->memory.state();
  }

  std::vector<double> as_received() const override {
    const std::lock_guard lock(mutex_);
    return now_->writer.positions_held();
  }

  State state() const override { return state_; }

  Stats stats() const override {
    const std::lock_guard lock(mutex_);
    Stats now = stats_;
    now.state = state_;
    return now;
  }

 private:
  enum class Phase { kDown, kUpload, kAnnounced, kLive };

  /// When the work on a pose began, and when its coefficients were there; 0: they were given.
  struct Work {
    TimeUs begun_us = 0;
    TimeUs transformed_us = 0;
  };

  /// To another asset of the surface.
  struct Change {
    std::unique_ptr<Sending> to;
    Ramp ramp;
    bool asked = false;  ///< The broker.
    std::optional<control::Announced> granted{};
  };

  /// On the caller's thread.
  void learn_from(const VertexPose& pose, std::span<const double> C, TimeUs capture_us) {
    std::unique_lock lock(mutex_);
    const LearnUse use = learn_;
    const bool is_changing = change_.has_value();
    lock.unlock();
    if (use == LearnUse::kOff) return learner_.reset();
    if (is_changing) return;
    if (!learner_) {
      const auto take = [this](const std::shared_ptr<const Asset>& from, const LearntAsset& learnt) {
        if (asset() != from) return;
        if (const auto changes = change_to(learnt.asset, learnt.encoded, learnt.coarser); !changes)
          log(log_, LogLevel::kError, "what was learnt is not used: " + changes.error().message);
      };
      learner_ = std::make_unique<StreamLearner>(use, take, log_);
    }
    if (learns_in_ != now_->asset.get()) {
      learner_->begin(now_->asset, now_->encoded, error_bound(options_, *now_->asset));
      learns_in_ = now_->asset.get();
    }
    if (learner_->wants(capture_us)) learner_->add(pose.positions, C, capture_us);
  }

  void restart_still() {
    still_.reset();
    if (now_->asset && options_.still_heartbeat_us > 0)
      still_.emplace(kStillOverError * error_bound(options_, *now_->asset), options_.still_heartbeat_us);
  }

  void upload_change() {
    change_->asked = false;
    change_->granted.reset();
    if (!change_uploader_) {
      AssetUploader::Events upload;
      upload.on_progress = [](std::uint64_t, std::uint64_t) {};
      upload.on_done = [this](const Result<void>& done) { return on_change_uploaded(done); };
      upload.on_exception = [this](const std::string& what) {
        const std::lock_guard lock(mutex_);
        drop_change(what);
      };
      change_uploader_ = std::make_unique<AssetUploader>(change_->to->encoded, std::move(upload));
    }
    change_uploader_->use(change_->to->encoded);
    change_uploader_->begin(at_, milliseconds(0));
  }

  /// On the uploader's thread.
  std::optional<milliseconds> on_change_uploaded(const Result<void>& done) {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kLive || !change_) return std::nullopt;
    if (!done) {
      log(log_, LogLevel::kWarning, "the next asset: " + done.error().message);
      return done.error().code == ErrorCode::kRefused ? kRefusedRetry : kUploadRetry;
    }
    control::Announce m = announcement(*change_->to);
    m.continues = true;
    change_->asked = true;
    (void)socket_->send_text(text_from_control(m));
    return std::nullopt;
  }

  /// The stream goes on as it is.
  void drop_change(const std::string& why) {
    if (!change_) return;
    change_.reset();
    log(log_, LogLevel::kError, "the next asset is not used: " + why);
  }

  control::Announce announcement(const Sending& of) const {
    control::Announce m;
    m.asset = of.encoded->manifest.id.hex();
    m.format = of.format;
    m.key_rate_hz = options_.key_rate_hz;
    m.world = options_.world;
    m.resume = resume_;
    return m;
  }

  /// V: empty, or velocities per second; S: r x scalars.
  SendStatus send(std::span<const double> C, std::span<const double> V, std::span<const double> S, TimeUs capture_us,
                  const Work& work) {
    const std::lock_guard lock(mutex_);
    if (V.empty() == options_.velocities)
      return unusable(fail(ErrorCode::kInvalidArgument, V.empty() ? "a pose without velocities, which were announced"
                                                                  : "velocities that were not announced"));
    if (S.size() != now_->format.rows * now_->format.scalars.size())
      return unusable(
          fail(ErrorCode::kInvalidArgument, "a pose without the scalars that were announced, or with more"));
    std::vector<double> all;
    if (now_->format.channels > 3) C = all = rows_in_format(now_->format, C, V, S);
    if (ramp_ && C.size() == std::size_t{now_->format.rows} * now_->format.channels)
      C = all = ramp_->blended(C, now_->format.channels);
    if (const auto early = send_blocker(capture_us)) return *early;
    auto key = key_from_coefficients(now_->writer.layout(), C, now_->quantiser.step);
    if (!key) return unusable(key.error());
    if (!now_->writer.held() || !still_) return send_next(std::move(*key), capture_us, work);
    return send_unless_still(std::move(*key), C, capture_us, work);
  }

  /// The gate stays as it was where a frame is not sent. REQUIRES: as send_next; a key was sent, and there is a gate.
  SendStatus send_unless_still(Key key, std::span<const double> C, TimeUs capture_us, const Work& work) {
    const StillGate before = *still_;
    const double distance =
        surface_distance(C, coefficients_from_key(now_->writer.layout(), *now_->writer.held()), now_->asset->area);
    switch (still_->next(distance, capture_us)) {
      case StillGate::Action::kSkip:
        ++stats_.frames_held;
        return SendStatus::kSent;
      case StillGate::Action::kHold: {
        const SendStatus held = send_next(*now_->writer.held(), capture_us, work);
        if (held != SendStatus::kSent) still_ = before;
        return held;
      }
      case StillGate::Action::kResume:
        if (const auto held = send_next(*now_->writer.held(), still_->held_until_us(), work);
            held != SendStatus::kSent) {
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
    if (!now_->memory.decides()) return send_coded(now_->writer.code(std::move(key), capture_us), work);
    auto coded = now_->writer.code(key, capture_us);
    return send_coded(std::move(coded), work, &key);
  }

  /// Counted. REQUIRES: mutex_ is held.
  std::optional<SendStatus> send_blocker(TimeUs capture_us) {
    if (state_ != State::kLive) return dropped(DropReason::kDisconnected);
    if (socket_->unsent_bytes() > options_.max_unsent_bytes) return dropped(DropReason::kBehind);
    if (auto usable = check_capture_time(capture_us); !usable) return unusable(usable.error());
    if (!now_->writer.may_follow(capture_us)) return dropped(DropReason::kTime);
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
    if (pose != nullptr && now_->writer.state() != nullptr) keep(*pose, *coded, bytes);
    now_->writer.sent(*std::move(coded), bytes);
    if (ramp_) {
      ramp_->sent();
      if (ramp_->is_over()) ramp_.reset();
    }
    ++stats_.frames_sent;
    if (recalled) ++stats_.frames_recalled;
    stats_.payload_bytes += bytes;
    if (trace_every_ != 0) trace(work, sent_us);
    return status;
  }

  // The memory of poses. All but the callback REQUIRE: mutex_ is held.

  /// REQUIRES: the key has left; a key before it.
  void keep(const Key& pose, const KeyWriter::Coded& coded, std::size_t bytes) {
    const bool due = now_->memory.add({*now_->writer.state(), pose, bytes, coded.next.phase,
                                       now_->writer.half_spacing(), coded.capture_us, now_->memory.may_grow()},
                                      steady_now_us());
    stats_.saved_bytes = saved_before_ + now_->memory.saved_bytes();
    if (now_->memory.state().generation != 0) stats_.memory_bytes = memory_before_ + now_->memory.bytes();
    if (!due) return;
    if (auto asked = remember_now(now_->memory.segments_to_keep()); !asked) refuse_memory(asked.error());
  }

  Result<void> remember_now(std::vector<CodedSegment> segments) {
    if (auto wanted = now_->memory.want(std::move(segments)); !wanted) return wanted;
    if (phase_ == Phase::kLive) upload_memory();
    return {};
  }

  /// The broker has nothing of it (any more).
  void forget_memory() {
    if (segment_uploader_) segment_uploader_->cancel();
    now_->writer.code_by({}, {}, false);
    now_->memory.forget();
  }

  void upload_memory() {
    auto objects = std::make_shared<EncodedAsset>();
    objects->chunks = now_->memory.missing();
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
    if (phase_ != Phase::kLive || !now_->memory.state().pending) return;
    if (!done) return refuse_memory(done.error());
    if (socket_->send_text(text_from_control(now_->memory.message(url_.stream))) != SendStatus::kSent)
      return refuse_memory(fail(ErrorCode::kDisconnected, "the broker takes no messages now"));
    if (now_->memory.asked()) now_->writer.code_by({}, {}, false);
  }

  void refuse_memory(const Error& why) {
    now_->memory.refuse(why, steady_now_us());
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
    if (now_->writer.sequence() % trace_every_ == 0) {
      control::Trace m;
      m.stream_id = now_->writer.stream_id();
      m.epoch = now_->writer.epoch();
      m.sequence = now_->writer.sequence();
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
    state_ = State::kUploading;
    at_ = broker;
    at_.prefix = url_.prefix;
    stats_.detail = "connected to " + at_.origin();
    asset_uploader_->begin(at_, milliseconds(0));
    if (const std::string line = retries_.succeeded(); !line.empty()) log(log_, LogLevel::kInfo, line);
  }

  void on_down(const Error& why, milliseconds wait) {
    std::unique_lock lock(mutex_);
    phase_ = Phase::kDown;
    if (change_) change_->granted.reset();
    if (change_uploader_) change_uploader_->cancel();
    now_->writer.restart();
    forget_memory();
    stats_.subscribers = 0;
    stats_.gave_up = wait.count() == 0;
    state_ = why.code == ErrorCode::kRefused || wait.count() == 0 ? State::kRefused : State::kConnecting;
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
    if (phase_ == Phase::kLive && change_ && change_->asked) change_->granted = m;
    if (phase_ != Phase::kAnnounced) return;
    phase_ = Phase::kLive;
    resume_ = m.resume;
    now_->writer.begin(m);
    forget_memory();
    if (now_->memory.state().pending) upload_memory();
    if (change_) upload_change();
    if (still_) still_->restart();
    state_ = State::kLive;
    const std::string live = stats_.detail = "live at " + at_.origin() + url_.prefix + "/" + url_.stream;
    lock.unlock();
    log(log_, LogLevel::kInfo, live + ", epoch " + std::to_string(m.epoch));
  }

  void on_message(const control::Remembered& m) {
    const std::lock_guard lock(mutex_);
    if (phase_ != Phase::kLive || !now_->memory.awaits(m.generation)) return;
    if (!m.code.empty()) return refuse_memory({code_named(m.code), m.message});
    const auto poses = now_->memory.hold();
    if (!poses) return;
    log(log_, LogLevel::kInfo, "keys are predicted from a memory of " + std::to_string(poses->pose_count()) + " poses");
    const auto recaller = std::make_shared<Recaller>(*poses);
    const auto coder = [recaller](const ChainState& state, const Key& key, std::uint8_t half_spacing) {
      return recaller->encode(state, key, half_spacing);
    };
    now_->writer.code_by(coder, *poses, true);
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
    if (phase_ == Phase::kLive && change_ && change_->asked && !change_->granted) return drop_change(text);
    stats_.detail = text;
    if (phase_ == Phase::kAnnounced || phase_ == Phase::kLive) {
      now_->writer.restart();
      phase_ = Phase::kUpload;
      state_ = lacks_asset ? State::kUploading : State::kRefused;
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
      state_ = refused ? State::kRefused : State::kUploading;
      stats_.detail = done.error().message + try_again_in(wait);
      log(log_, LogLevel::kWarning, stats_.detail);
      return wait;
    }
    const control::Announce m = announcement(*now_);
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
  const LogSink log_;

  std::unique_ptr<Sending> now_;  ///< Replaced by the caller's thread alone, with mutex_.

  RetryLog retries_;  ///< For the connection's thread alone.

  // For the caller's thread alone.
  std::unique_ptr<StreamLearner> learner_;  ///< Null: nothing is learnt (yet).
  const Asset* learns_in_ = nullptr;        ///< What it began with.

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_):
  std::unique_ptr<WebSocket> socket_;              ///< Set once by start().
  std::unique_ptr<AssetUploader> asset_uploader_;  ///< Likewise.
  Phase phase_ = Phase::kDown;
  std::string resume_;  ///< Takes the stream over, at this broker and at others.
  BrokerUrl at_;        ///< The broker that it is or was connected to.
  bool ever_open_ = false;
  std::optional<StillGate> still_;  ///< Where still surfaces are not to be sent again and again.
  LearnUse learn_ = LearnUse::kOff;
  std::optional<Change> change_;                    ///< Under way.
  std::unique_ptr<AssetUploader> change_uploader_;  ///< Once there was one.
  std::optional<Ramp> ramp_;                        ///< While it lasts.
  TimeUs progress_us_ = 0;
  std::unique_ptr<AssetUploader> segment_uploader_;  ///< Once there was something to upload.
  Stats stats_;
  // In place of the one of stats_; written while mutex_ is held.
  std::atomic<State> state_ = State::kConnecting;
  std::uint64_t saved_before_ = 0, memory_before_ = 0;  ///< Of memories in assets before this one.
  std::uint32_t trace_every_ = 0;                       ///< Keys of which the broker wants traces; 0: none.
  ClockOffset clock_;                                   ///< The broker's; learnt while there are traces.
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
  auto sending = std::make_unique<Sending>(options, codec, std::move(format), std::move(asset), std::move(encoded));
  return started(std::move(options), std::move(*url), std::move(sending), std::move(log));
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
  auto sending = std::make_unique<Sending>(options, *codec, format, nullptr, std::move(encoded));
  return started(std::move(options), std::move(*url), std::move(sending), std::move(log));
}

}  // namespace eigencast
