// SPDX-License-Identifier: MIT
#include "broker/connections/rewind.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <utility>

#include "broker/relay/fair_reads.h"
#include "broker/relay/hub.h"
#include "broker/sockets/turn.h"
#include "broker/storage/history.h"

namespace eigencast::broker {
namespace {

constexpr TimeUs kAgainUs = 200'000;  ///< Where more is still being written.
constexpr TimeUs kMaxWaitUs = 5'000'000;
constexpr TimeUs kPausedTickUs = 5'000'000;  ///< Whether it gives way.
constexpr std::uint32_t kFirstEpoch = 0x8000'0000;  ///< Those of senders are below.

TimeUs times(TimeUs us, double factor) {
  return static_cast<TimeUs>(std::llround(static_cast<double>(us) * factor));
}

}  // namespace

void Replay::add(Passage passage, bool seeks) {
  if (seeks) waiting_.clear();
  at_once_ = at_once_ || seeks;
  ended_ = passage.ends;
  if (passage.poses.empty()) return;
  read_at_us_ = passage.poses.back().at_us;
  if (seeks) speed_ = passage.begins->rewind.speed;
  waiting_.push_back(std::move(passage));
}

std::optional<TimeUs> Replay::next_due_us() const {
  if (waiting_.empty()) return std::nullopt;
  if (at_once_) return start_us_;
  const TimeUs at_us = waiting_.front().poses.front().at_us;
  // Nobody waits through a gap.
  const bool gap = waiting_.front().begins && at_us - shown_at_us_ > PastReader::kSeamUs;
  return start_us_ + times((gap ? shown_at_us_ : at_us) - start_at_us_, 1 / speed_);
}

std::optional<Replay::Due> Replay::pop_due(TimeUs now_us) {
  const auto due_us = next_due_us();
  if (!due_us || (!at_once_ && *due_us > now_us)) return std::nullopt;
  Passage& first = waiting_.front();
  const Passage::Pose pose = std::move(first.poses.front());
  Due due{std::exchange(first.begins, std::nullopt), pose.key};
  if (due.begins) {
    at_once_ = false;
    speed_ = due.begins->rewind.speed;
    start_us_ = now_us;
    start_at_us_ = pose.at_us;
  } else if (now_us - *due_us > kLateUs) {
    start_us_ += now_us - *due_us;
  }
  shown_at_us_ = pose.at_us;
  first.poses.pop_front();
  if (first.poses.empty()) waiting_.pop_front();
  return due;
}

TimeUs Replay::position_us(TimeUs now_us) const {
  return start_at_us_ + times(now_us - start_us_, speed_);
}

std::optional<TimeUs> Replay::wants(TimeUs now_us) const {
  const TimeUs until_us = position_us(now_us) + times(kAheadUs, speed_);
  if (speed_ == 0 || at_once_ || ended_ || waiting_.size() > 1 || read_at_us_ > until_us) return std::nullopt;
  return until_us + times(kAheadUs, speed_);
}

Rewind::Rewind(Context& context, Viewer& viewer, const control::Seek& first, std::string holder, const Profile& wanted,
               std::shared_ptr<void> place)
    : context_(context),
      viewer_(&viewer),
      name_(first.stream),
      holder_(std::move(holder)),
      profile_(wanted),
      place_(std::move(place)),
      reader_(*context.history.kept, first.stream, context.hub.poses_charge(holder_)),
      timer_(context.loop.get_executor()) {}

Rewind::~Rewind() {
  if (stream_) context_.hub.forget_apart(*stream_);
}

void Rewind::stop() {
  viewer_ = nullptr;
  place_.reset();
  timer_.cancel();
}

Profile Rewind::profile() const {
  Profile profile = profile_;
  if (replay_.speed() > 1) profile = {.rate = Profile::Rate::kRaw, .bands = profile_.bands};
  return profile;
}

void Rewind::seek(const control::Seek& wanted) {
  sought_ = wanted;
  if (!reading_) arm(steady_now_us());
}

bool Rewind::read(std::optional<TimeUs> until_us) {
  struct Reading {
    std::shared_ptr<Rewind> self{};
    Viewer* payer = nullptr;  ///< Pays even if it stops meanwhile.
    std::shared_ptr<void> alive{};
    std::optional<Result<Passage>> passage{};
  };
  const auto reading = std::make_shared<Reading>();
  const auto wanted = [weak = weak_from_this(), reading] {
    reading->self = weak.lock();
    if (!reading->self || reading->self->viewer_ == nullptr) return false;
    reading->payer = reading->self->viewer_;
    reading->alive = reading->payer->lifetime();
    return true;
  };
  const auto load = [reading, sought = until_us ? std::nullopt : sought_, until_us] {
    PastReader& reader = reading->self->reader_;
    try {
      reading->passage = sought ? reader.seek(*sought, steady_now_us()) : reader.go_on(*until_us);
    } catch (const std::exception& exception) {
      reading->passage = fail(ErrorCode::kInternal, exception.what());
    }
  };
  const auto then = [reading, seeks = !until_us] {
    const auto self = std::move(reading->self);
    self->take(*reading->passage, seeks, reading->payer->pay(self->reader_.took_us()));
  };
  reading_ = true;
  if (!context_.past_reads.push(holder_, {wanted, load, then})) return reading_ = false;
  if (!until_us) sought_.reset();
  return true;
}

void Rewind::take(const Result<Passage>& read, bool sought, TimeUs pause_us) {
  reading_ = false;
  if (viewer_ == nullptr) return;
  const TimeUs now_us = steady_now_us();
  if (!read) {
    if (!sought) {
      log(context_.log, LogLevel::kWarning,
          "the history of '" + name_ + "' cannot be read on: " + read.error().message);
      return viewer_->show_present(*this);
    }
    viewer_->refuse_seek(*this, read.error());
    return viewer_ != nullptr ? run() : void();
  }
  paid_us_ = now_us + std::min(pause_us, kMaxWaitUs);
  again_us_ = std::max(paid_us_, read->poses.empty() ? now_us + kAgainUs : now_us);
  if (sought && read->poses.empty()) {
    if (sought_) return arm(now_us);
    return viewer_->show_present(*this);
  }
  replay_.add(*read, sought);
  run();
}

void Rewind::run() {
  const TimeUs now_us = steady_now_us();
  while (const auto due = replay_.pop_due(now_us)) {
    if (due->begins && !begin(*due->begins, due->key, now_us)) return;
    if (!due->begins) stream_->take_record(due->key, now_us);
  }
  if (stream_) {
    context_.hub.mark_dirty(*stream_);
    (void)context_.turn.now_us();  // What is dirty is delivered when the turn ends.
    const TimeUs lag_us = context_.history.kept->unix_from_steady(now_us) - replay_.position_us(now_us);
    if (!sought_ && context_.history.give_way(replay_.paused_us(now_us))) return viewer_->show_present(*this);
    if (!sought_ && (replay_.is_over() || (replay_.speed() >= 1 && lag_us < PastReader::kLiveUs / 2)))
      return viewer_->show_present(*this);
  }
  arm(now_us);
}

/// False: this has ended.
bool Rewind::begin(const Passage::Beginning& begins, const KeyRecordPtr& key, TimeUs now_us) {
  const TimeUs span_us = context_.config.frames.max_span_ms * 1000;
  const double speed = begins.rewind.speed;
  auto made = context_.hub.make_apart(name_, holder_, begins.announced.format,
                                      speed > 0 && speed < 1 ? times(span_us, 1 / speed) : span_us);
  if (made) {
    (*made)->set_rewind(begins.rewind);
    const auto begun = (*made)->announce(begins.announced, kFirstEpoch | ++context_.history.epochs);
    if (!begun) made = begun.error();
  }
  if (!made) {
    Viewer& viewer = *viewer_;
    viewer.refuse_seek(*this, made.error());
    if (viewer_ != nullptr) viewer.show_present(*this);
    return false;
  }
  KeyRecord first = *key;
  first.arrival_us = now_us;
  (*made)->take_record(std::make_shared<const KeyRecord>(std::move(first)), now_us);
  const auto former = std::exchange(stream_, std::move(*made));
  const bool shown = viewer_->show_past(*this, former.get());
  if (former) context_.hub.forget_apart(*former);
  return shown;
}

void Rewind::arm(TimeUs now_us) {
  std::optional<TimeUs> due_us = replay_.next_due_us();
  if (!reading_) {
    const auto until_us = sought_ ? std::nullopt : replay_.wants(now_us);
    if (sought_ || until_us) {
      TimeUs from_us = sought_ ? paid_us_ : again_us_;
      if (from_us <= now_us && !read(until_us)) from_us = now_us + kAgainUs;
      if (from_us > now_us) due_us = std::min(due_us.value_or(from_us), from_us);
    } else if (!due_us && replay_.speed() > 0 && stream_) {
      due_us = now_us + kAgainUs;
    } else if (!due_us && stream_) {
      due_us = now_us + kPausedTickUs;
    }
  }
  if (!due_us) return;
  timer_.expires_at(std::chrono::steady_clock::time_point(std::chrono::microseconds(*due_us)));
  timer_.async_wait([self = shared_from_this(), alive = viewer_->lifetime()](ErrorOf error) {
    if (!error && self->viewer_ != nullptr) self->run();
  });
}

}  // namespace eigencast::broker
