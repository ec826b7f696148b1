// SPDX-License-Identifier: MIT
#include "sdk/broker_publisher.h"

#include <chrono>
#include <mutex>
#include <variant>

#include "common/core/text.h"
#include "sdk/broker.h"

namespace eigencast {

BrokerPublisher::BrokerPublisher(PublisherOptions options, BrokerUrl url, std::unique_ptr<Sending> sending, LogSink log)
    : options_(std::move(options)), url_(std::move(url)), log_(std::move(log)), now_(std::move(sending)) {
  BrokerPublisher::learn(options_.learn);
  restart_still();
  stats_.detail = "connecting to " + url_.origin();
}

void BrokerPublisher::start() {
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

BrokerPublisher::~BrokerPublisher() {
  learner_.reset();
  if (asset_uploader_) asset_uploader_->stop();
  if (change_uploader_) change_uploader_->stop();
  if (segment_uploader_) segment_uploader_->stop();
  if (socket_) socket_->stop();
}

std::shared_ptr<const Asset> BrokerPublisher::asset() const {
  const std::lock_guard lock(mutex_);
  return now_->asset;
}

Publisher::Stats BrokerPublisher::stats() const {
  const std::lock_guard lock(mutex_);
  Stats now = stats_;
  now.state = state_;
  return now;
}

control::Announce BrokerPublisher::announcement(const Sending& of) const {
  control::Announce m;
  m.asset = of.encoded->manifest.id.hex();
  m.format = of.format;
  m.key_rate_hz = options_.key_rate_hz;
  m.world = options_.world;
  m.utc_us = utc_us_;
  m.resume = resume_;
  return m;
}

void BrokerPublisher::on_open(const BrokerUrl& broker) {
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

void BrokerPublisher::on_down(const Error& why, milliseconds wait) {
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

void BrokerPublisher::on_text(std::string_view text) {
  if (const auto message = read_control(text, log_)) std::visit([this](const auto& m) { on_message(m); }, *message);
}

void BrokerPublisher::on_message(const control::Announced& m) {
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

void BrokerPublisher::on_message(const control::Subscribers& m) {
  const std::lock_guard lock(mutex_);
  stats_.subscribers = m.count;
}

void BrokerPublisher::on_message(const control::Ping& m) {
  const std::lock_guard lock(mutex_);
  (void)socket_->send_text(text_from_control(control::Pong{m.id, m.time_us, steady_now_us()}));
}

void BrokerPublisher::on_message(const control::Pong& m) {
  const std::lock_guard lock(mutex_);
  clock_.add(m.time_us, m.peer_time_us, steady_now_us());
}

void BrokerPublisher::on_message(const control::TraceRequest& m) {
  const std::lock_guard lock(mutex_);
  trace_every_ = m.every;
}

void BrokerPublisher::on_message(const control::ErrorMessage& m) {
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

void BrokerPublisher::on_message(const control::Bye& m) {
  std::unique_lock lock(mutex_);
  socket_->hold_off(milliseconds(m.retry_after_ms));
  lock.unlock();
  log(log_, LogLevel::kInfo, "the broker leaves: " + m.reason);
}

void BrokerPublisher::on_progress(std::uint64_t sent, std::uint64_t total) {
  const std::lock_guard lock(mutex_);
  stats_.detail =
      formatted("uploading %.1f of %.1f MB", static_cast<double>(sent) / 1e6, static_cast<double>(total) / 1e6);
}

auto BrokerPublisher::on_uploaded(const Result<void>& done) -> std::optional<milliseconds> {
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

void BrokerPublisher::upload_failed(const std::string& what) {
  std::unique_lock lock(mutex_);
  if (phase_ == Phase::kAnnounced) phase_ = Phase::kUpload;
  stats_.detail = what + try_again_in(kUploadRetry);
  if (phase_ == Phase::kUpload) asset_uploader_->begin(at_, kUploadRetry);
  lock.unlock();
  log(log_, LogLevel::kError, what);
}

}  // namespace eigencast
