// SPDX-License-Identifier: MIT
#include "broker/connections/turn.h"

#include <boost/asio/post.hpp>
#include <utility>

#include "broker/connections/uring.h"

namespace eigencast::broker {

Turn::Turn(asio::io_context& loop, const Settings& settings, LogSink log, std::function<void()> deliver,
           std::function<void()> prepare)
    : loop_(loop),
      log_(std::move(log)),
      deliver_(std::move(deliver)),
      prepare_(std::move(prepare)),
      wanted_(settings.backend),
      gathering_(settings.gathering),
      timer_(loop.get_executor()) {}

Turn::~Turn() = default;

void Turn::begin() {
  if (wanted_ == Settings::Backend::kEpoll || ring_) return;
  auto ring = Uring::open();
  if (ring) {
    ring_ = std::move(*ring);
    return;
  }
  log(log_, LogLevel::kWarning, "writes go one by one, because io_uring is not to be had: " + ring.error().message);
}

const char* Turn::backend() const {
  return ring_ ? "io_uring" : "epoll";
}

TimeUs Turn::begin_turn() {
  now_us_ = steady_now_us();
  arm_end();
  return *now_us_;
}

void Turn::add(Leaver& leaver, bool may_wait) {
  if (leaver.line_ == Leaver::Line::kNow || (may_wait && leaver.line_ == Leaver::Line::kTick)) return;
  forget(leaver);
  enter(leaver, may_wait ? Leaver::Line::kTick : Leaver::Line::kNow);
  if (may_wait) {
    arm_tick();
  } else {
    arm_end();
  }
}

void Turn::enter(Leaver& leaver, Leaver::Line line) {
  auto& list = list_of(line);
  leaver.line_ = line;
  leaver.place_ = static_cast<std::uint32_t>(list.size());
  list.push_back(&leaver);
}

void Turn::forget(Leaver& leaver) {
  if (leaver.line_ == Leaver::Line::kNone) return;
  list_of(leaver.line_)[leaver.place_] = nullptr;
  leaver.line_ = Leaver::Line::kNone;
}

void Turn::arm_end() {
  if (std::exchange(end_armed_, true)) return;
  asio::post(loop_, [this] { end_turn(); });
}

void Turn::end_turn() {
  try {
    deliver_();
    end_armed_ = false;
    leave_all(now_);
  } catch (...) {  // What could not be done now is done at the end of the next turn: there must be one.
    end_armed_ = false;
    now_us_.reset();
    throw;
  }
  now_us_.reset();
  prepare_();
}

void Turn::arm_tick() {
  if (std::exchange(tick_armed_, true)) return;
  timer_.expires_at(
      std::chrono::steady_clock::time_point(std::chrono::microseconds(gathering_.next_tick_us(now_us()))));
  timer_.async_wait([this](ErrorOf error) {
    tick_armed_ = false;
    if (!error) leave_all(tick_);
  });
}

void Turn::leave_all(std::vector<Leaver*>& list) {
  // Who cannot write all now, or is owed more by what the others' outcomes do, enters the next turn.
  leaving_.clear();  // Of a turn that failed.
  leaving_.swap(list);
  std::erase(leaving_, nullptr);
  for (Leaver* leaver : leaving_) leaver->line_ = Leaver::Line::kNone;
  if (ring_) {
    ring_->write(leaving_);
  } else {
    for (Leaver* leaver : leaving_) leaver->leave();
  }
  leaving_.clear();
}

}  // namespace eigencast::broker
