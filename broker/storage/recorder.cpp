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

constexpr TimeUs kFlushEveryUs = 200'000;
constexpr TimeUs kRemoveUs = 50'000;  ///< At a time, while what comes waits.
constexpr TimeUs kSyncEveryUs = 1'000'000;
constexpr TimeUs kRecountEveryUs = 60'000'000;
// Approximate sizes of a queue entry without its payload, and of what a session and a surface take.
constexpr std::int64_t kItemBytes = 200, kSessionBytes = 1000, kScalarBytes = 200;
constexpr std::int64_t kMaxBegun = 256;  ///< Files that are kept, in a second.
constexpr std::int64_t kUnbounded = std::int64_t{1} << 62;

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

void Recorder::end_by(TimeUs end_us) {
  const std::lock_guard lock(mutex_);
  end_us_ = end_us;
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
  if (found != sessions_.end()) {
    announce(found->second, stream);
  } else if (settings_.streams.matches(stream.name()) && used_up(stream.payer()) == nullptr) {
    announce(add(stream.name(), true), stream);
  }
}

bool Recorder::is_full(const Session& session, TimeUs arrival_us) const {
  if (settings_.keep_us == 0 || !session.announced) return false;
  const TimeUs age_us = arrival_us - session.begun_us;
  const std::uint64_t bytes = session.info.bytes;
  return age_us >= kLongestPieceUs || (age_us >= kPieceUs && bytes >= 4 * session.object_bytes) ||
         bytes >= std::min(kMaxPieceBytes, settings_.max_total_bytes / 16);
}

bool Recorder::announce(const SessionPtr& session, const Stream& stream, TimeUs first_us) {
  if (!session->begun) session->payer = stream.payer();
  const std::size_t segments = stream.memory() ? stream.memory()->segments.size() : 0;
  const auto bytes = kSessionBytes + kItemBytes * static_cast<std::int64_t>(1 + segments) +
                     kScalarBytes * std::ssize(stream.announcement().format.scalars);
  Item item{.kind = Item::Kind::kAnnounce, .session = session, .arrival_us = first_us};
  item.begins = std::make_unique<const Item::Surface>(
      Item::Surface{stream.announcement(), stream.memory(), stream.layout(), stream.payer()});
  session->announced = push(std::move(item), bytes, settings_.max_queued_bytes);
  if (!session->announced) return false;
  session->begun = session->wants_checkpoint = true;
  session->memory = stream.memory() ? stream.memory()->number : 0;
  return true;
}

/// Counts them: one costs the folder, and viewers, more than its keys.
bool Recorder::may_begin(const std::string& holder, TimeUs now_us) {
  if (settings_.keep_us == 0) return true;
  if (now_us < second_us_ || now_us - second_us_ >= 1'000'000) {
    second_us_ = now_us;
    begun_.clear();
    all_begun_ = 0;
  }
  std::int64_t& own = begun_[holder];
  if (own >= share_of(kMaxBegun, all_begun_, own, holder.empty())) return false;
  ++own;
  ++all_begun_;
  return true;
}

void Recorder::on_key(const Stream& stream, const KeyRecordPtr& record) {
  if (active_.load(std::memory_order_relaxed) == 0) return;
  const std::lock_guard lock(mutex_);
  auto found = sessions_.find(stream.name());
  if (found == sessions_.end()) return;
  if (is_full(*found->second, record->arrival_us) && may_begin(stream.payer(), record->arrival_us)) {
    found->second->goes_on = true;
    end(found->second);
    add(stream.name(), true)->follows = true;
    found = sessions_.find(stream.name());
  }
  Session& session = *found->second;
  if (session.failed || steady_now_us() < session.resume_us) return;
  const auto drop = [&] {
    ++session.dropped;
    ++session.info.dropped;
    ++totals_.dropped;
    session.wants_checkpoint = true;
  };
  if (!session.begun) {
    if (!session.follows && !may_begin(stream.payer(), record->arrival_us)) return drop();
    session.begun_us = record->arrival_us;
  }
  const bool tells = !session.announced || record->generation > session.memory;
  if (tells && !announce(found->second, stream, record->arrival_us)) return drop();
  const bool gap = session.wants_checkpoint;
  const bool checkpoint = gap || record->arrival_us - session.checkpoint_us >= settings_.checkpoint_us ||
                          ++session.keys >= settings_.checkpoint_keys;
  const std::size_t held = record->payload.size() + (checkpoint ? memory_of(*record->after) : 0);
  const std::int64_t bytes = kItemBytes + static_cast<std::int64_t>(held);
  Item item{.session = found->second, .arrival_us = record->arrival_us, .dropped = session.dropped};
  if (!gap) item.frame = record->frame();
  if (checkpoint) {
    item.state.sequence = record->sequence;
    item.state.capture_us = record->capture_us;
    item.state.after = record->after;
  }
  if (!push(std::move(item), bytes, settings_.max_queued_bytes)) return drop();
  session.wants_checkpoint = false;
  session.dropped = 0;
  if (!checkpoint) return;
  session.checkpoint_us = record->arrival_us;
  session.keys = 0;
}

void Recorder::on_stalled(const Stream& stream) {
  if (active_.load(std::memory_order_relaxed) == 0) return;
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(stream.name());
  if (found != sessions_.end() && found->second->automatic) end(found->second);
}

bool Recorder::push(Item item, std::int64_t bytes, std::int64_t max_bytes) {
  const std::string payer = item.session->payer;
  if (!queue_.push(payer, bytes, std::move(item), max_bytes)) return false;
  totals_.queued_bytes += bytes;
  return true;
}

void Recorder::end(const SessionPtr& session) {
  const bool nothing = session->automatic && !session->begun && !session->follows;
  if (!nothing) push({.kind = Item::Kind::kEnd, .session = session}, kSessionBytes, kUnbounded);
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
  for (bool behind = false;;) {
    TimeUs until_us = 0;
    const bool last = [&] {
      std::unique_lock lock(mutex_);
      if (!behind) stop_.wait_for(lock, std::chrono::microseconds(kFlushEveryUs), [this] { return stopping_; });
      // What was held up by others before the end has as long as at any time.
      until_us = std::max(stopping_ ? end_us_ : 0, steady_now_us() + kFlushEveryUs);
      return stopping_;
    }();
    behind = !work_until(until_us);
    const bool sync = last || steady_now_us() - synced_us >= kSyncEveryUs;
    if (sync) synced_us = steady_now_us();
    flush_all(sync);
    if (last) return leave_rest();
    behind |= !remove_oldest(steady_now_us() + kRemoveUs);
    if (steady_now_us() - counted_us < kRecountEveryUs) continue;
    counted_us = steady_now_us();
    recount();
  }
}

/// Whether nothing waits any more.
bool Recorder::work_until(TimeUs until_us) {
  for (std::int64_t done = 0;;) {
    Item item;
    {
      const std::lock_guard lock(mutex_);
      totals_.queued_bytes -= std::exchange(done, 0);
      if (queue_.empty()) return true;
      if (steady_now_us() >= until_us) return false;
      auto next = queue_.pop();
      item = std::move(next.item);
      done = next.cost;
    }
    try {
      work(item);
    } catch (const std::exception& exception) {
      fail_session(*item.session, fail(ErrorCode::kIo, exception.what()));
    }
  }
}

void Recorder::leave_rest() {
  const std::lock_guard lock(mutex_);
  std::uint64_t frames = 0;
  while (!queue_.empty()) frames += queue_.pop().item.kind == Item::Kind::kKey ? 1 : 0;
  totals_.dropped += frames;
  if (frames == 0) return;
  log(log_, LogLevel::kWarning,
      std::to_string(frames) + " frames are not in " + settings_.folder +
          ": the broker stopped before the disk had taken them");
}

}  // namespace eigencast::broker
