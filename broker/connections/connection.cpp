// SPDX-License-Identifier: MIT
#include "broker/connections/connection.h"

#include <algorithm>
#include <boost/asio/bind_allocator.hpp>
#include <boost/asio/post.hpp>
#include <ctime>
#include <memory_resource>
#include <utility>

#include "broker/sockets/loop_share.h"

namespace eigencast::broker {
namespace {

using websocket::CloseCode;
using websocket::Opcode;

// Reads per turn, and work, so that a busy sender does not starve other connections.
constexpr int kMaxReads = 4;
constexpr double kTurnUs = 500, kViewersTurnUs = 100;
// What took longer than so many times its estimate, and so much more, was interrupted by other programs.
constexpr double kMostTimes = 5, kMostMoreUs = 500;

constexpr double kBinaryBytesPerUs = 2'000;
// JSON at its worst, "[]" over and over; acknowledgements and all else that is common is shorter.
constexpr double kShortBytes = 1024, kJsonBytesPerUs = 28;
// Rare, so that a pause costs little beside what it is for.
constexpr TimeUs kMinPauseUs = 5'000;

// A client whose rights changed may reconnect at once.
constexpr std::uint32_t kRightsRetryMs = 500;

constexpr double kAnswerUs = 3;

// Longer control messages count as several.
constexpr double kBytesPerMessage = 256;

double json_us(std::uint64_t bytes) {
  return std::max(static_cast<double>(bytes) - kShortBytes, 0.0) / kJsonBytesPerUs;
}

/// What it takes beyond its reading; an acknowledgement nothing.
double work_us_of(const ControlMessage& message) {
  if (std::holds_alternative<control::Announce>(message) || std::holds_alternative<control::Remember>(message))
    return 100;
  if (std::holds_alternative<control::Subscribe>(message) || std::holds_alternative<control::Enter>(message) ||
      std::holds_alternative<control::Seek>(message))
    return 45;
  if (const auto* say = std::get_if<control::Say>(&message)) return 5 + 0.6 * static_cast<double>(say->values.size());
  if (std::holds_alternative<control::History>(message)) return 10;
  const bool cheap = std::holds_alternative<control::Ack>(message) || std::holds_alternative<control::Late>(message);
  return cheap ? 0 : kAnswerUs;
}

/// What it makes the loop do, in messages of the cheapest kind, which take about a microsecond.
int weight_of(const ControlMessage& message) {
  // Every viewer is told, every chain begins anew.
  if (std::holds_alternative<control::Announce>(message) || std::holds_alternative<control::Remember>(message))
    return 100;
  if (std::holds_alternative<control::Say>(message) || std::holds_alternative<control::Floor>(message)) return 4;
  const bool joins = std::holds_alternative<control::Subscribe>(message) ||
                     std::holds_alternative<control::Enter>(message) || std::holds_alternative<control::Seek>(message);
  return joins ? 20 : 1;
}

Outbox::Limits outbox_limits(const Config& config) {
  return {.max_control_messages = static_cast<std::size_t>(config.limits.max_queued_control_messages),
          .max_control_bytes = static_cast<std::size_t>(config.limits.max_queued_control_bytes),
          .window_slack_us = config.frames.window_ms * 1000};
}

/// Keeps the kernel's send buffer small, so that the newest pose waits here, where a newer one can replace it.
void tune(Transport& transport, const Config& config) {
  ErrorOf ignored;
  transport.socket().set_option(Tcp::no_delay(config.sockets.no_delay), ignored);
  transport.limit_unsent(static_cast<int>(config.sockets.unsent_bytes));
  transport.limit_send_buffer(static_cast<int>(config.sockets.send_buffer_bytes));
}

}  // namespace

Connection::Connection(Context& context, Transport transport, GrantPtr grant,
                       const websocket::MessageReader::Limits& limits, const Outbox::Limits* outbox)
    : context_(context),
      transport_(std::move(transport)),
      outbox_(outbox != nullptr ? *outbox : outbox_limits(context.config)),
      grant_(std::move(grant)),
      reader_(limits) {
  tune(transport_, context.config);
}

void Connection::start(std::string answer) {
  guarded([&] {
    last_input_us_ = opened_us_ = context_.turn.now_us();
    id_ = ++context_.last_connection_id;
    watch_ = ReaderWatch(id_);
    open_ = true;
    blocked_ = false;
    counted_ = counted_in(context_.connection_count);
    context_.connections.emplace_hint(context_.connections.end(), id_, this);
    send_framed(std::make_shared<const std::string>(std::move(answer)));
    wait_to_read(Transport::Wait::kReadable);
    on_open();
    schedule_write();
  });
}

void Connection::log_failure(const std::exception& exception) noexcept {
  try {
    log(context_.log, LogLevel::kError, name() + ": closed, the broker failed: " + exception.what());
  } catch (const std::exception&) {  // Not even memory for the line.
  }
}

void Connection::wait_to_read(Transport::Wait wait) {
  auto handler = [self = shared_from_this()](ErrorOf error) {
    self->guarded([&] {
      if (error) return self->ended();
      self->on_readable();
    });
  };
  if (wait == Transport::Wait::kReadable && transport_.has_read_ahead()) {  // The socket does not signal it.
    return asio::post(context_.loop, [handler = std::move(handler)] { handler({}); });
  }
  // Exact memory: an idle connection waits for long, and a block that Asio recycles may be much larger.
  transport_.async_wait(wait, asio::bind_allocator(std::pmr::polymorphic_allocator<>(), std::move(handler)));
}

void Connection::on_readable() {
  if (takes_turns()) return in_turn(reading_, &Connection::read);
  turn_us_ = 0;
  read();
}

void Connection::beat() {
  in_turn(telling_, &Connection::on_beat);
}

void Connection::in_turn(Asked& asked, void (Connection::*work)()) {
  if (ended_ || asked.waits) return;
  const TimeUs from_us = steady_now_us();
  asked.paid_us = 0;
  if (context_.viewers.is_free(from_us)) return run_paid(asked, work);
  asked.paid_us = std::max(asked.took_us, 1.0);  // It will be as the last time.
  const auto then = [self = shared_from_this(), &asked, work, from_us] {
    asked.waits = false;
    asked.waited_us = steady_now_us() - from_us;
    self->guarded([&] { self->run_paid(asked, work); });
  };
  asked.waits = !context_.viewers.take(grant_->holder(), asked.paid_us, 0, then);
  if (!asked.waits) run_paid(asked, work);
}

void Connection::run_paid(Asked& asked, void (Connection::*work)()) {
  const TimeUs from_us = steady_now_us();
  turn_us_ = 0;
  (this->*work)();
  const TimeUs now_us = steady_now_us();
  asked.took_us = std::clamp(static_cast<double>(now_us - from_us), turn_us_, kMostTimes * turn_us_ + kMostMoreUs);
  context_.viewers.pay(asked.took_us - asked.paid_us, now_us);
}

void Connection::read() {
  if (ended_) return;  // Since this was posted.
  if (const TimeUs waited_us = std::exchange(reading_.waited_us, 0); waited_us > 0) {
    last_input_us_ = context_.turn.now_us();  // Its silence is not its own.
    reader_.excuse(waited_us);
  }
  if (unpaid_us_ > 0) pay(0);
  if (paused_) return;
  // Without bytes too: a frame may be paid for, and be empty.
  if (Bytes unread = std::exchange(unread_, {}); !take_input(unread)) return;
  for (int i = 0; i < kMaxReads; ++i) {
    const std::span<std::uint8_t> buffer = std::span(context_.read_buffer).first(read_bytes());
    const Transport::Outcome outcome = transport_.read(buffer);
    const auto records = static_cast<double>(transport_.take_records());
    if (outcome.error) return close_now();
    if (outcome.wait != Transport::Wait::kNo) {
      unpaid_us_ = kReadUs * records;
      if (unpaid_us_ > 0) pay(0);
      return paused_ ? void() : wait_to_read(outcome.wait);
    }
    last_input_us_ = context_.turn.now_us();
    pinged_us_ = 0;
    if (records > 1) charge(kReadUs * (records - 1));
    unpaid_us_ = kReadUs;  // Included in the cost of a frame that begins.
    if (!take_input(buffer.first(outcome.bytes))) return;
    if (unpaid_us_ > 0) pay(0);
    if (paused_) return;
    if (!transport_.is_tls() && outcome.bytes < buffer.size()) break;
  }
  wait_to_read(Transport::Wait::kReadable);
}

bool Connection::take_input(std::span<std::uint8_t> input) {
  while (!paused_) {
    const auto event = reader_.next(input, last_input_us_);
    if (!event) break;
    on_event(*event);
    if (ended_) return false;
  }
  unread_.assign(input.begin(), input.end());
  count_unfinished();
  paused_ = paused_ || is_backlogged();
  return !paused_;
}

void Connection::on_event(const websocket::MessageReader::Event& event) {
  using Kind = websocket::MessageReader::Event::Kind;
  const auto text = [&] {
    return std::string_view(reinterpret_cast<const char*>(event.payload.data()), event.payload.size());
  };
  if (event.kind == Kind::kFrame) return begin_frame(event);
  if (event.kind == Kind::kClose || event.kind == Kind::kFailed) {
    close_received_ = true;  // Later bytes cannot be parsed.
    if (closing_) return end_writing_when_closed();
    return event.kind == Kind::kClose ? close_when_sent({}, event.code) : on_broken(event);
  }
  if (closing_) return;
  if (const auto taken = grant_->take_message(context_.turn.now_us()); !taken) {
    log(context_.log, LogLevel::kWarning, name() + ": closed, " + taken.error().message);
    return refuse(taken.error(), {}, CloseCode::kPolicy);
  }
  if (event.kind == Kind::kBinary) return on_binary(event.payload);
  if (event.kind == Kind::kText) return on_text(text());
  if (event.kind == Kind::kPing) return on_ping(text());
  if (event.kind == Kind::kPong && watch_.note_pong(text())) {
    outbox_.hold_from(watch_.hold_from_us());
    schedule_write();
  }
}

void Connection::on_ping(std::string_view payload) {
  charge(kAnswerUs);
  const bool late = !outbox_.push_pong(websocket::framed(Opcode::kPong, payload));
  if (late && !blocked_) flush();
  schedule_write();
}

bool Connection::is_backlogged() {
  const auto many = static_cast<std::size_t>(context_.config.limits.max_queued_control_messages) / 2;
  if (outbox_.control_messages() < many) return false;
  if (!blocked_) flush();  // The socket may still take them.
  return blocked_ && outbox_.control_messages() >= many;
}

double Connection::binary_work_us(std::uint64_t bytes, bool /*last*/) const {
  return 1 + static_cast<double>(bytes) / kBinaryBytesPerUs;
}

void Connection::charge(double work_us) {
  note_work(work_us);
  (void)grant_->take_work(work_us, context_.turn.now_us(), kForeverUs);
}

TimeUs Connection::take_control(double messages) {
  const auto per_s = static_cast<double>(context_.config.limits.control_messages_per_s);
  return *control_.take(messages, per_s, per_s, context_.turn.now_us(), kForeverUs);
}

void Connection::begin_frame(const websocket::MessageReader::Event& event) {
  const bool binary = event.opcode == Opcode::kBinary;
  const auto bytes = static_cast<double>(event.bytes);
  const double messages = 1 + bytes / kBytesPerMessage;
  unpaid_us_ = binary ? binary_work_us(event.bytes, event.last)
                      : std::max(messages, json_us(event.before + event.bytes) - json_us(event.before));
  pay(binary ? 0 : take_control(messages));
}

void Connection::pay(TimeUs wait_us) {
  const auto taken = grant_->take_work(unpaid_us_, context_.turn.now_us(), kMaxPauseUs);
  turn_us_ += unpaid_us_;
  const bool full = turn_us_ > (takes_turns() ? kViewersTurnUs : kTurnUs) && turn_us_ > unpaid_us_;
  if (taken) unpaid_us_ = 0;
  const TimeUs work_wait_us = taken.value_or(kMaxPauseUs);
  if (std::max(wait_us, work_wait_us) == 0) return full ? pause(0) : void();
  log(context_.log, LogLevel::kWarning,
      name() + ": read later, " +
          (wait_us > work_wait_us ? "it is over limits.control_messages_per_s"
                                  : grant_->label() + " is over work_us_per_s"));
  on_paced(wait_us > work_wait_us ? "limits.control_messages_per_s" : "work_us_per_s");
  charge(kPauseUs);
  pause(std::max({wait_us, work_wait_us, kMinPauseUs}));
}

void Connection::pause(TimeUs wait_us) {
  paused_ = true;
  last_input_us_ = context_.turn.now_us() + wait_us;  // Its silence is not its own.
  if (wait_us > 0) reader_.excuse(wait_us);
  pause_ = std::make_unique<Timer>(context_.loop.get_executor());
  run_after(*pause_, std::chrono::microseconds(wait_us), [self = shared_from_this()] {
    self->pause_.reset();
    self->guarded([&] { self->resume_reading(); });
  });
}

void Connection::resume_reading() {
  if (!paused_ || pause_ || ended_ || is_backlogged()) return;
  paused_ = false;
  asio::post(context_.loop, [self = shared_from_this()] { self->guarded([&] { self->on_readable(); }); });
}

void Connection::end_writing_when_closed() {
  if (close_queued_ && close_received_ && write_queue_.empty()) transport_.end_writing();
}

void Connection::on_broken(const websocket::MessageReader::Event& event) {
  const std::string why(event.why);
  log(context_.log, LogLevel::kWarning, name() + ": closed, it sent " + why);
  if (event.code != CloseCode::kTooBig) return close_when_sent(why, event.code);
  refuse(fail(ErrorCode::kTooLarge, why + ": see section 11 of the protocol, and limits.max_control_bytes and "
                                          "limits.max_frame_bytes of this broker"),
         {}, event.code);
}

void Connection::count_unfinished() {
  const std::size_t in_kernel = paused_ && !transport_.is_wide() ? transport_.unread() : 0;
  const std::size_t bytes = reader_.held_bytes() + unread_.capacity() + unread_answers() + in_kernel;
  if (bytes == unfinished_bytes_) return;
  unfinished_bytes_ = bytes;
  unfinished_.reset();
  const auto held = store(unfinished_, grant_->hold_bytes(unfinished_bytes_));
  if (!held) give_message_up(held.error());
}

void Connection::give_message_up(const Error& why) {
  reader_.stop();
  Bytes().swap(unread_);
  unfinished_bytes_ = reader_.held_bytes();
  unfinished_.reset();
  close_received_ = true;  // Later bytes cannot be parsed.
  log(context_.log, LogLevel::kWarning, name() + ": closed, " + why.message);
  refuse(why, stream_name(), CloseCode::kTryAgainLater);
}

void Connection::greet() {
  send(control::Welcome{context_.version, context_.session_id, steady_now_us()});
}

void Connection::send(const ControlMessage& message) {
  if (!closing_ && !ended_) send(websocket::framed(Opcode::kText, text_from_control(message)));
}

void Connection::send(const Outbox::Text& control) {
  if (closing_ || ended_) return;
  ++context_.counters.control_sent;
  send_framed(control);
}

void Connection::send_framed(const Outbox::Text& text) {
  if (closing_ || ended_) return;
  if (outbox_.push_control(text)) return schedule_write();
  // Many requests in one turn make many answers before its end; the socket may still take them.
  if (!blocked_) flush();
  if (!blocked_ && outbox_.push_control(text)) return schedule_write();
  ++context_.counters.slow_disconnects;
  log(context_.log, LogLevel::kWarning, name() + ": closed, it does not take its control messages");
  closing_ = true;
  close_code_ = CloseCode::kPolicy;
  close_later();  // The caller may be iterating over all watchers.
}

std::string Connection::name() const {
  return label() + " #" + std::to_string(id_);
}

void Connection::describe(ClientInfo& info) const {
  info.id = id_;
  info.who = grant_->label();
  info.connected_us = context_.turn.now_us() - opened_us_;
  info.frames_sent = frames_sent_;
  info.bytes_sent = bytes_sent_;
  info.round_trip_us = outbox_.round_trip_us();
  info.acknowledges = outbox_.acknowledges();
  info.dropped = outbox_.dropped_total();
  info.joins = outbox_.joins_total();
  info.control_waiting = outbox_.control_messages();
}

void Connection::send_error(const Error& error, const std::string& stream) {
  // The protocol's names: an order that differs from the enumeration's would change them.
  static_assert(name_of(ErrorCode::kRefused) == "refused" && name_of(ErrorCode::kCancelled) == "cancelled" &&
                name_of(ErrorCode::kInternal) == "internal");
  send(control::ErrorMessage{std::string(name_of(error.code)), error.message, stream});
}

void Connection::refuse(const Error& error, const std::string& stream, CloseCode code) {
  send_error(error, stream);
  close_when_sent(error.message, code);
}

/// Answers an unknown op; closes the connection otherwise.
void Connection::refuse_text(const Error& error) {
  if (error.code == ErrorCode::kUnsupported) return send_error(error, stream_name());
  log(context_.log, LogLevel::kWarning, name() + ": closed, " + error.message);
  refuse(error, stream_name(), error.code == ErrorCode::kTooLarge ? CloseCode::kTooBig : CloseCode::kBadPayload);
}

void Connection::send_bye(const std::string& reason, std::uint32_t retry_after_ms, CloseCode code) {
  send(control::Bye{reason, retry_after_ms});
  close_when_sent(reason, code);
}

void Connection::close_when_sent(const std::string& reason, CloseCode code) {
  if (closing_ || ended_) return;
  closing_ = true;
  close_code_ = code;
  close_reason_ = reason;
  deadline_ = std::make_unique<Timer>(context_.loop.get_executor());
  run_after(*deadline_, std::chrono::milliseconds(context_.config.timeouts.shutdown_ms),
            [self = shared_from_this()] { self->close_now(); });
  schedule_write();
}

void Connection::tick() {
  const TimeUs now_us = context_.turn.now_us(), silent_us = reading_.waits ? 0 : now_us - last_input_us_;
  const TimeUs idle_us = context_.config.timeouts.idle_ms * 1000;
  // A broker that was stopped has not asked.
  if (silent_us > idle_us && pinged_us_ != 0 && now_us - pinged_us_ > idle_us / 2) {
    log(context_.log, LogLevel::kWarning,
        name() +
            (paused_ ? ": closed, it asks and has not taken the answers for " : ": closed, nothing came from it for ") +
            std::to_string(silent_us / 1'000'000) + " s (timeouts.idle_ms)");
    return close_later();
  }
  if (!reading_.waits && reader_.behind_us(now_us) > idle_us) {
    return give_message_up(fail(ErrorCode::kTimeout,
                                "a message came more slowly than 4,000 bytes a second, by more than "
                                "timeouts.idle_ms: try a faster link, or smaller messages"));
  }
  if (!closing_) count_unfinished();  // What is not read may have grown without a request.
  if (silent_us > idle_us / 2 && pinged_us_ == 0) {
    pinged_us_ = now_us;
    send_framed(websocket::framed(Opcode::kPing, {}));
  }
  if (!closing_ && grant_->has_expired(std::time(nullptr))) {
    log(context_.log, LogLevel::kInfo, name() + ": closed, the token of " + grant_->label() + " has expired");
    return send_bye("the token has expired: connect with a new one", 0, CloseCode::kPolicy);
  }
  if (!closing_ && grant_->is_void()) {
    log(context_.log, LogLevel::kInfo, name() + ": closed, the configuration no longer lets in " + grant_->label());
    return send_bye("the rights of this connection have changed: connect again", kRightsRetryMs, CloseCode::kPolicy);
  }
  pay_for_output();
  if (watch_.is_probing()) check_window();  // The TCP acknowledgement of a ping shows the window even without a pong.
  on_tick();
}

void Connection::close_later() {
  asio::post(context_.loop, [self = shared_from_this()] { self->close_now(); });
}

void Connection::close_now() {
  context_.turn.forget(*this);
  blocked_ && open_ ? transport_.reset() : transport_.close();
  ended();
}

void Connection::ended() {
  if (std::exchange(ended_, true)) return;
  if (deadline_) deadline_->cancel();
  if (pause_) pause_->cancel();
  context_.turn.forget(*this);
  blocked_ = true;
  write_queue_.clear();
  if (!open_) return;
  pay_for_output();
  counted_.reset();
  context_.connections.erase(id_);
  on_closed();
}

void Connection::on_text(std::string_view text) {
  ++context_.counters.control_received;
  const auto message = control_from_text(text);
  if (!message) return refuse_text(message.error());
  (void)take_control(weight_of(*message) - 1);
  charge(work_us_of(*message));
  const auto* ping = std::get_if<control::Ping>(&*message);
  if (ping != nullptr) return send(control::Pong{ping->id, ping->time_us, steady_now_us()});
  if (!std::holds_alternative<control::Pong>(*message)) on_message(*message);
}

}  // namespace eigencast::broker
