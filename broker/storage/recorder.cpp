// SPDX-License-Identifier: MIT
#include "broker/storage/recorder.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "broker/relay/stream.h"
#include "broker/storage/recorder_parts.h"
#include "common/core/clock.h"
#include "common/core/share.h"

namespace eigencast::broker {
namespace {

constexpr std::chrono::milliseconds kFlushEvery{200};
constexpr TimeUs kSyncEveryUs = 1'000'000;
constexpr TimeUs kRecountEveryUs = 60'000'000;
constexpr std::int64_t kItemBytes = 200;  ///< Approximate size of a queue entry without its payload.

}  // namespace

Recorder::Recorder(Settings settings, AssetStore& assets, LogSink log)
    : settings_(std::move(settings)),
      assets_(assets),
      log_(std::move(log)),
      unix_ahead_us_(unix_at_steady_zero_us()),
      thread_([this] { run(); }) {}

Recorder::~Recorder() {
  {
    const std::lock_guard lock(mutex_);
    while (!sessions_.empty()) end(sessions_.begin()->second);
    stopping_ = true;
  }
  stop_.notify_all();
  thread_.join();
}

Recorder::SessionPtr Recorder::add(std::string_view stream, bool automatic) {
  auto session = std::make_shared<Session>();
  session->stream = session->info.stream = stream;
  session->automatic = automatic;
  sessions_.emplace(std::string(stream), session);
  active_ = totals_.active = sessions_.size();
  return session;
}

Result<void> Recorder::start(std::string_view stream) {
  const std::lock_guard lock(mutex_);
  if (sessions_.contains(stream)) {
    return fail(ErrorCode::kRefused, "'" + std::string(stream) + "' is being recorded already");
  }
  if (totals_.stored_bytes >= settings_.max_total_bytes) {
    return fail(ErrorCode::kTooLarge, "the recordings take " + std::to_string(totals_.stored_bytes) +
                                          " bytes, all that recording.max_total_bytes allows: remove some of " +
                                          settings_.folder + " and try again a minute later");
  }
  add(stream, false);
  return {};
}

Result<void> Recorder::stop(std::string_view stream) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(stream);
  if (found == sessions_.end()) {
    return fail(ErrorCode::kNotFound, "'" + std::string(stream) + "' is not being recorded");
  }
  end(found->second);
  return {};
}

std::vector<RecordingInfo> Recorder::list() const {
  const std::lock_guard lock(mutex_);
  std::vector<RecordingInfo> all;
  for (const auto& [name, session] : sessions_) all.push_back(session->info);
  all.insert(all.end(), ended_.begin(), ended_.end());
  return all;
}

Recorder::Totals Recorder::totals() const {
  const std::lock_guard lock(mutex_);
  Totals totals = totals_;
  totals.failing = static_cast<std::uint64_t>(
      std::count_if(sessions_.begin(), sessions_.end(), [](const auto& one) { return one.second->resume_us != 0; }));
  return totals;
}

std::vector<Recorder::Piece> Recorder::pieces(std::string_view stream) const {
  const std::lock_guard lock(kept_mutex_);
  const auto found = kept_.find(stream);
  std::vector<Piece> all;
  if (found == kept_.end()) return all;
  for (const KeptPtr& kept : found->second) all.push_back(*kept);
  return all;
}

void Recorder::on_announced(const Stream& stream) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(stream.name());
  if (settings_.keep_us > 0) {
    if (found != sessions_.end()) end(found->second);
    if (keeps(stream.name())) add(stream.name(), true);
    return;
  }
  if (found != sessions_.end()) return announce(found->second, stream);
  const bool wanted = settings_.streams.matches(stream.name());
  if (wanted && used_up(stream.payer()) == nullptr) announce(add(stream.name(), true), stream);
}

bool Recorder::is_full(const Session& session, TimeUs arrival_us) const {
  if (settings_.keep_us == 0 || !session.announced) return false;
  const TimeUs age_us = arrival_us - session.begun_us;
  const std::uint64_t bytes = session.info.bytes;
  return age_us >= kLongestPieceUs || (age_us >= kPieceUs && bytes >= 4 * session.object_bytes) ||
         bytes >= std::min(kMaxPieceBytes, settings_.max_total_bytes / 16);
}

void Recorder::announce(const SessionPtr& session, const Stream& stream, TimeUs first_us) {
  session->announced = session->wants_checkpoint = true;
  session->memory = stream.memory() ? stream.memory()->number : 0;
  const std::size_t segments = stream.memory() ? stream.memory()->segments.size() : 0;
  // Ignores the bound, not its count: keys behind it are dropped before. The file is unreadable without it.
  push({.kind = Item::Kind::kAnnounce,
        .session = session,
        .arrival_us = first_us,
        .announced = stream.announcement(),
        .memory = stream.memory(),
        .layout = stream.layout(),
        .holder = stream.payer(),
        .bytes = kItemBytes * static_cast<std::int64_t>(1 + segments)});
}

void Recorder::on_key(const Stream& stream, const KeyRecordPtr& record) {
  if (active_.load(std::memory_order_relaxed) == 0) return;
  const std::lock_guard lock(mutex_);
  auto found = sessions_.find(stream.name());
  if (found == sessions_.end()) return;
  if (is_full(*found->second, record->arrival_us)) {
    found->second->goes_on = true;
    end(found->second);
    add(stream.name(), true)->follows = true;
    found = sessions_.find(stream.name());
  }
  Session& session = *found->second;
  if (session.failed || steady_now_us() < session.resume_us) return;
  if (!session.announced) {
    session.begun_us = record->arrival_us;
    announce(found->second, stream, record->arrival_us);
  }
  const bool recalls_more = record->generation > session.memory;
  const bool gap = session.wants_checkpoint || recalls_more;
  const bool checkpoint = gap || record->arrival_us - session.checkpoint_us >= settings_.checkpoint_us ||
                          ++session.keys >= settings_.checkpoint_keys;
  const std::size_t held = record->payload.size() + (checkpoint ? memory_of(*record->after) : 0);
  const std::int64_t bytes = kItemBytes + static_cast<std::int64_t>(held);
  const auto mine = queued_.find(stream.payer());
  const std::int64_t own = mine == queued_.end() ? 0 : mine->second;
  if (own + bytes > share_of(settings_.max_queued_bytes, totals_.queued_bytes, own)) {
    ++session.dropped;
    ++session.info.dropped;
    ++totals_.dropped;
    session.wants_checkpoint = true;
    return;
  }
  if (recalls_more) announce(found->second, stream);
  session.wants_checkpoint = false;
  KeyRecord state;
  if (checkpoint) {
    session.checkpoint_us = record->arrival_us;
    session.keys = 0;
    state.sequence = record->sequence;
    state.capture_us = record->capture_us;
    state.after = record->after;
  }
  push({.session = found->second,
        .arrival_us = record->arrival_us,
        .frame = gap ? Bytes() : record->frame(),
        .state = std::move(state),
        .dropped = std::exchange(session.dropped, 0),
        .holder = stream.payer(),
        .bytes = bytes});
}

void Recorder::on_stalled(const Stream& stream) {
  if (active_.load(std::memory_order_relaxed) == 0) return;
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(stream.name());
  if (found != sessions_.end() && found->second->automatic) end(found->second);
}

void Recorder::push(Item item) {
  totals_.queued_bytes += item.bytes;
  queued_[item.holder] += item.bytes;
  queue_.push_back(std::move(item));
}

void Recorder::end(const SessionPtr& session) {
  push({.kind = Item::Kind::kEnd, .session = session});
  sessions_.erase(session->stream);
  active_ = totals_.active = sessions_.size();
}

void Recorder::run() {
  try {
    repair();
  } catch (const std::exception& exception) {
    log(log_, LogLevel::kError, std::string("looking through the recordings failed: ") + exception.what());
  }
  TimeUs synced_us = steady_now_us(), counted_us = synced_us;
  for (bool last = false; !last;) {
    std::deque<Item> items;
    {
      std::unique_lock lock(mutex_);
      stop_.wait_for(lock, kFlushEvery, [this] { return stopping_; });
      items.swap(queue_);
      last = stopping_;
    }
    for (; !items.empty(); items.pop_front()) {
      Item& item = items.front();
      try {
        work(item);
      } catch (const std::exception& exception) {
        fail_session(*item.session, fail(ErrorCode::kIo, exception.what()));
      }
      const std::lock_guard lock(mutex_);
      totals_.queued_bytes -= item.bytes;
      if ((queued_[item.holder] -= item.bytes) == 0) queued_.erase(item.holder);
    }
    const bool sync = last || steady_now_us() - synced_us >= kSyncEveryUs;
    if (sync) synced_us = steady_now_us();
    flush_all(sync);
    remove_oldest();
    if (steady_now_us() - counted_us < kRecountEveryUs) continue;
    counted_us = steady_now_us();
    recount();
  }
}

}  // namespace eigencast::broker
