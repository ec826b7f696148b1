// SPDX-License-Identifier: MIT
#include "sdk/broker_connection.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "common/wire/limits.h"
#include "sdk/broker.h"

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr TimeUs kAckIntervalUs = 33'000;
constexpr milliseconds kTick{40};

SharedByBroker<BrokerConnection>& connections() {
  static SharedByBroker<BrokerConnection> all;
  return all;
}

}  // namespace

std::shared_ptr<BrokerConnection> BrokerConnection::join(const BrokerUrl& url, Request request, Listener& listener) {
  return connections().get(url, [&](BrokerConnection& connection) { return connection.try_join(request, listener); });
}

std::shared_ptr<BrokerConnection> BrokerConnection::enter(const BrokerUrl& url, const std::string& room,
                                                          RoomListener& listener) {
  return connections().get(url, [&](BrokerConnection& connection) { return connection.try_enter(room, listener); });
}

BrokerConnection::BrokerConnection(const BrokerUrl& url) : url_(url) {}

BrokerConnection::~BrokerConnection() {
  if (socket_) socket_->stop();
}

bool BrokerConnection::try_join(Request& request, Listener& listener) {
  const std::lock_guard lock(mutex_);
  if (crowded_ || find(request.subscribe.stream) != nullptr) return false;
  Stream& stream = streams_.emplace_back();
  stream.request = std::move(request);
  stream.listener = &listener;
  if (socket_ == nullptr) {
    start();
  } else if (open_) {
    listener.on_open(at_);
    if (const auto clock = clock_.estimate()) listener.on_clock(*clock);
    subscribe(stream);
  } else {
    if (down_) listener.on_down(down_->first, down_->second);
    socket_->retry_now();  // As a connection of its own would.
  }
  return true;
}

bool BrokerConnection::try_enter(const std::string& room, RoomListener& listener) {
  const std::lock_guard lock(mutex_);
  if (!rooms_.try_emplace(room, &listener).second) return false;
  if (socket_ == nullptr) {
    start();
  } else if (open_) {
    send(listener.on_room_open());
  } else {
    if (down_) listener.on_room_down(down_->first);
    socket_->retry_now();
  }
  return true;
}

void BrokerConnection::start() {
  WebSocketOptions options;
  options.url = url_;
  options.tick = kTick;
  WebSocketEvents events;
  events.on_try = [this] { return next_target(); };
  events.on_open = [this](const BrokerUrl& broker) { on_open(broker); };
  events.on_tick = [this] { on_tick(); };
  events.on_text = [this](std::string_view text) { on_text(text); };
  events.on_binary = [this](ByteView bytes) { on_binary(bytes); };
  events.on_down = [this](const Error& why, milliseconds wait) { on_down(why, wait); };
  socket_ = WebSocket::start(std::move(options), std::move(events),
                             [this](LogLevel level, std::string_view text) { log(level, text); });
}

void BrokerConnection::send_in_room(const ControlMessage& message) {
  const std::lock_guard lock(mutex_);
  if (open_) send(message);
}

void BrokerConnection::leave(const RoomListener& listener, const std::string& room) {
  const std::lock_guard lock(mutex_);
  const auto at = rooms_.find(room);
  if (at == rooms_.end() || at->second != &listener) return;
  if (open_) send(control::Leave{room});
  rooms_.erase(at);
}

void BrokerConnection::hold(const Listener& listener, std::uint32_t generation) {
  const std::lock_guard lock(mutex_);
  for (Stream& stream : streams_) {
    if (stream.listener == &listener) stream.generation = generation;
  }
}

void BrokerConnection::say(const Listener& listener, const ControlMessage& message) {
  const std::lock_guard lock(mutex_);
  for (const Stream& stream : streams_) {
    if (stream.listener == &listener && stream.id && open_) send(message);
  }
}

void BrokerConnection::leave(const Listener& listener) {
  const std::lock_guard lock(mutex_);
  const auto at = std::find_if(streams_.begin(), streams_.end(), [&](auto& s) { return s.listener == &listener; });
  if (at == streams_.end()) return;
  if (!at->ask_again_at_us) {
    crowded_ = false;
    if (open_) send(control::Unsubscribe{at->name()});
  }
  streams_.erase(at);
}

std::string BrokerConnection::next_target() {
  const std::lock_guard lock(mutex_);
  url_stream_.clear();
  if (streams_.size() != 1 || !rooms_.empty()) return "/v1/subscribe";
  const control::Subscribe& only = streams_.front().request.subscribe;
  if (!only.sync.empty()) return "/v1/subscribe";  // A URL does not say it.
  url_stream_ = only.stream;
  return "/v1/subscribe/" + only.stream + "?" + query_from_profile(only.profile);
}

void BrokerConnection::on_open(const BrokerUrl& broker) {
  const std::lock_guard lock(mutex_);
  at_ = broker;
  open_ = true;
  crowded_ = false;
  down_.reset();
  if (const std::string line = retries_.succeeded(); !line.empty()) log(LogLevel::kInfo, line);
  clock_.reset();  // It may be another broker.
  last_ack_us_ = last_ping_us_ = 0;
  if (!url_stream_.empty() && find(url_stream_) == nullptr) send(control::Unsubscribe{url_stream_});
  for (Stream& stream : streams_) {
    stream.id.reset();
    stream.reader.restart();
    stream.ack.reset();
    stream.generation = 0;
    stream.ask_again_at_us.reset();
    stream.listener->on_open(at_);
    if (stream.name() != url_stream_) subscribe(stream);
  }
  for (const auto& [room, listener] : rooms_) send(listener->on_room_open());
}

void BrokerConnection::on_down(const Error& why, milliseconds wait) {
  const std::lock_guard lock(mutex_);
  const bool refused_one = !open_ && !url_stream_.empty() && why.code == ErrorCode::kRefused;
  open_ = false;
  if (refused_one && streams_.size() > 1) return socket_->retry_now();  // That concerns one stream only.
  if (!refused_one) down_ = {why, wait};
  if (const std::string line = retries_.failed(why.message); !line.empty())
    log(LogLevel::kWarning, line + try_again_in(wait));
  for (const Stream& stream : streams_) stream.listener->on_down(why, wait);
  for (const auto& [room, listener] : rooms_) listener->on_room_down(why);
}

void BrokerConnection::on_text(std::string_view text) {
  const std::lock_guard lock(mutex_);
  const auto message = read_control(text, [this](LogLevel level, std::string_view line) { log(level, line); });
  if (message) std::visit([this](const auto& m) { on_message(m); }, *message);
}

void BrokerConnection::on_message(const control::StreamInfo& m) {
  Stream* stream = find(m.stream);
  if (stream == nullptr) return;
  const bool first = !stream->id;
  stream->id = m.stream_id;
  stream->reader.begin(m.stream_id, m.tag, m.epoch);
  stream->ask_again_at_us.reset();
  stream->listener->on_info(m);
  if (first && stream->request.trace_every > 0) send(control::TraceRequest{m.stream, stream->request.trace_every});
}

void BrokerConnection::on_message(const control::Remember& m) {
  if (const Stream* stream = find(m.stream)) stream->listener->on_memory(m);
}

void BrokerConnection::on_message(const control::Trace& m) {
  for (const Stream& stream : streams_) {
    if (stream.id == m.stream_id) stream.listener->on_trace(m);
  }
}

void BrokerConnection::on_message(const control::Ping& m) {
  send(control::Pong{m.id, m.time_us, steady_now_us()});
}

void BrokerConnection::on_message(const control::Pong& m) {
  clock_.add(m.time_us, m.peer_time_us, steady_now_us());
  const auto clock = clock_.estimate();
  for (const Stream& stream : streams_) {
    if (clock) stream.listener->on_clock(*clock);
  }
}

void BrokerConnection::on_message(const control::Notice& m) {
  for_each(m.stream, [&](Stream& stream) { stream.listener->on_notice(m); });
}

void BrokerConnection::on_message(const control::Moment& m) {
  if (const Stream* stream = find(m.stream)) stream->listener->on_moment(m);
}

void BrokerConnection::on_message(const control::History& m) {
  if (const Stream* stream = find(m.stream)) stream->listener->on_history(m);
}

void BrokerConnection::on_message(const control::Room& m) {
  if (const auto at = rooms_.find(m.room); at != rooms_.end()) at->second->on_room(m);
}

void BrokerConnection::on_message(const control::ErrorMessage& m) {
  if (!m.room.empty()) {
    if (const auto at = rooms_.find(m.room); at != rooms_.end()) at->second->on_room_error(m);
    return;
  }
  const bool declined = !m.stream.empty();
  const bool crowded = declined && m.code == name_of(ErrorCode::kTooLarge) && streams_.size() > 1;
  crowded_ = crowded_ || crowded;
  for_each(m.stream, [&](Stream& stream) {
    if (declined) {
      stream.id.reset();
      stream.ask_again_at_us = steady_now_us() + TimeUs{stream.request.declined_retry.count()} * 1000;
    }
    crowded ? stream.listener->on_crowded_out() : stream.listener->on_error(m, declined);
  });
}

void BrokerConnection::on_message(const control::Bye& m) {
  socket_->hold_off(milliseconds(m.retry_after_ms));
  log(LogLevel::kInfo, "the broker leaves: " + m.reason);
}

void BrokerConnection::on_binary(ByteView bytes) {
  const TimeUs now = steady_now_us();
  const std::lock_guard lock(mutex_);
  const auto frame = parse_frame(bytes);
  if (!frame) log(LogLevel::kWarning, "frame not decoded: " + frame.error().message);
  for (Stream& stream : streams_) {
    if (!frame) {
      stream.listener->on_frame({}, bytes.size(), now);
    } else if (stream.id == frame->envelope.stream_id) {
      const auto whole = stream.reader.read(*frame);
      // Received is received: also what cannot be decoded no longer fills the link.
      if (whole) stream.ack = {*stream.id, whole->envelope.sequence, whole->envelope.step.byte()};
      stream.listener->on_frame(whole, bytes.size(), now);
    }
  }
  if (now - last_ack_us_ >= kAckIntervalUs) acknowledge(now);  // Last, so that the pose does not wait for it.
}

void BrokerConnection::on_tick() {
  const std::lock_guard lock(mutex_);
  const TimeUs now = steady_now_us();
  if (now - last_ack_us_ >= kAckIntervalUs) acknowledge(now);
  for (Stream& stream : streams_) {
    // The answer, of either kind, says how it goes on.
    if (stream.ask_again_at_us && now >= *stream.ask_again_at_us) subscribe(stream);
  }
  for (const auto& [room, listener] : rooms_) {
    for (const ControlMessage& message : listener->on_room_tick(now)) send(message);
  }
  if (now - last_ping_us_ < kPingIntervalUs) return;
  last_ping_us_ = now;
  send(control::Ping{++ping_id_, now});
}

void BrokerConnection::acknowledge(TimeUs now) {
  control::Ack ack{{}, now};
  const auto flush = [&] {
    if (!ack.items.empty()) send(ack);
    ack.items.clear();
  };
  for (Stream& stream : streams_) {
    if (!stream.ack) continue;
    last_ack_us_ = now;
    stream.ack->generation = std::exchange(stream.generation, 0);
    ack.items.push_back(*std::exchange(stream.ack, std::nullopt));
    if (ack.items.size() == limits::kMaxAcksPerMessage) flush();
  }
  flush();
}

void BrokerConnection::subscribe(Stream& stream) {
  stream.ask_again_at_us.reset();
  send(stream.request.subscribe);
}

BrokerConnection::Stream* BrokerConnection::find(std::string_view name) {
  const auto at = std::find_if(streams_.begin(), streams_.end(), [&](const Stream& s) { return s.name() == name; });
  return at == streams_.end() ? nullptr : &*at;
}

template <typename Call>
void BrokerConnection::for_each(std::string_view name_or_all, Call call) {
  for (Stream& stream : streams_) {
    if (name_or_all.empty() || stream.name() == name_or_all) call(stream);
  }
}

void BrokerConnection::log(LogLevel level, std::string_view text) const {
  const std::lock_guard lock(mutex_);
  if (!streams_.empty()) eigencast::log(streams_.front().request.log, level, text);
}

}  // namespace eigencast
