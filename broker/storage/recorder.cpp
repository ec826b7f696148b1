// SPDX-License-Identifier: MIT
#include "broker/storage/recorder.h"

#include <algorithm>
#include <chrono>
#include <ctime>
#include <exception>
#include <filesystem>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "broker/relay/stream.h"
#include "common/core/share.h"
#include "common/recording/reader.h"
#include "common/recording/writer.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr std::string_view kSuffix = ".ecrec";
constexpr milliseconds kFlushEvery{200};
constexpr TimeUs kSyncEveryUs = 1'000'000;
constexpr TimeUs kRecountEveryUs = 60'000'000;
constexpr std::size_t kEndedKept = 100;
constexpr std::int64_t kItemBytes = 200;  ///< Approximate size of a queue entry without its payload.
// Of what is kept: a file, longer where the memory that each needs would be most of it, and shorter for fast streams.
constexpr TimeUs kPieceUs = 60'000'000, kLongestPieceUs = 600'000'000;
constexpr std::uint64_t kMaxPieceBytes = 16 << 20;
constexpr std::size_t kMorePieces = 256;  ///< Of one stream: each announcement begins a file, and all are looked at.

/// What a file takes of the quotas: many small ones cost a folder, and this memory, too.
constexpr std::uint64_t file_cost(std::uint64_t bytes) {
  return std::max(charge_of(bytes), std::uint64_t{64} << 10);
}

std::uint64_t unix_us() {
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch())
          .count());
}

/// "lab/horse" becomes "lab~horse.20260101T120000Z": stream names have no '~'.
std::string file_stem(std::string_view stream) {
  std::string stem(stream);
  std::replace(stem.begin(), stem.end(), '/', '~');
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char text[32];
  std::strftime(text, sizeof text, ".%Y%m%dT%H%M%SZ", &utc);
  return stem + text;
}

}  // namespace

struct Recorder::Session {
  std::string stream;
  bool automatic = false;  ///< Started by a pattern: ends with the sender.

  // GUARDED_BY(Recorder::mutex_).
  bool announced = false;
  bool wants_checkpoint = true;
  std::uint32_t memory = 0;  ///< The generation that the file has.
  TimeUs checkpoint_us = 0;
  std::uint64_t keys = 0;  ///< Since then.
  TimeUs begun_us = 0;             ///< Arrival of its first key, where it is one of several files.
  bool follows = false;            ///< What the file before it ended with.
  bool goes_on = false;            ///< The file after it does so.
  std::uint64_t object_bytes = 0;  ///< Of the file.
  KeptPtr kept;
  std::uint64_t dropped = 0;  ///< Since the last enqueued key.
  bool failed = false;
  RecordingInfo info;

  // Belong to the thread.
  std::optional<recording::Writer> writer;
  CoefficientLayout layout;
  std::string asset;
  std::string holder;        ///< Pays for what is written from now on.
  std::set<Sha256> objects;  ///< In the file.
  TimeUs start_us = 0;
  TimeUs start_unix_us = 0;
  std::uint64_t written = 0;  ///< Bytes already counted in the totals.
  std::uint64_t charged = 0;  ///< The same, as the quotas count.
};

struct Recorder::Item {
  enum class Kind { kAnnounce, kKey, kEnd } kind = Kind::kKey;
  SessionPtr session{};
  TimeUs arrival_us = 0;          ///< kAnnounce: of the first key, or 0.
  Bytes frame{};                  ///< kKey. Empty: the checkpoint bridges it.
  KeyRecord state{};              ///< kKey, for a checkpoint: without payload. Without `after`: none is due.
  std::uint64_t dropped = 0;      ///< Keys dropped before this one.
  control::Announce announced{};  ///< kAnnounce
  GenerationPtr memory{};         ///< Likewise; null: none.
  CoefficientLayout layout{};
  std::string holder{};
  std::int64_t bytes = 0;
};

Recorder::Recorder(Settings settings, AssetStore& assets, LogSink log)
    : settings_(std::move(settings)),
      assets_(assets),
      log_(std::move(log)),
      unix_ahead_us_(static_cast<TimeUs>(unix_us()) - steady_now_us()),
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
  return totals_;
}

std::vector<Recorder::Piece> Recorder::pieces(std::string_view stream) const {
  const std::lock_guard lock(mutex_);
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
  if (session.failed) return;
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

void Recorder::repair() {
  std::error_code error;
  fs::create_directories(settings_.folder, error);
  for (fs::directory_iterator it(settings_.folder, error), end; !error && it != end; it.increment(error)) {
    const std::string path = it->path().string();
    if (!path.ends_with(kSuffix)) continue;
    const auto recovered = recording::recover(path);
    if (!recovered) {
      log(log_, LogLevel::kWarning, "a recording cannot be repaired: " + recovered.error().message);
      std::error_code ignored;
      if (settings_.keep_us > 0) fs::remove(path, ignored);
    } else if (!recovered->was_complete) {
      log(log_, LogLevel::kWarning,
          path + ": was cut off; repaired with " + std::to_string(recovered->frames) + " frames, " +
              std::to_string(recovered->cut_bytes) + " bytes of a torn one removed");
    }
    if (recovered && settings_.keep_us > 0) restore(path);
  }
  recount();
}

/// One that an earlier run kept; one of no use is removed.
void Recorder::restore(const std::string& path) {
  auto reader = recording::Reader::open(path);
  const auto announce = [&]() -> std::optional<control::Announce> {
    if (!reader || reader->index().empty() || !reader->seek(reader->index().front().time_us)) return std::nullopt;
    const auto record = reader->next();
    if (!record || !*record) return std::nullopt;
    const Bytes& body = (**record).body;
    const auto message = control_from_text({reinterpret_cast<const char*>(body.data()), body.size()});
    const auto* announced = message ? std::get_if<control::Announce>(&*message) : nullptr;
    return announced != nullptr ? std::optional(*announced) : std::nullopt;
  }();
  const TimeUs from_us = reader ? static_cast<TimeUs>(reader->info().start.started_unix_us) : 0;
  if (!announce || from_us > unix_from_steady(steady_now_us()) + kPieceUs) {
    std::error_code ignored;
    fs::remove(path, ignored);
    return;
  }
  auto kept = std::make_shared<Kept>();
  kept->file = path;
  kept->from_us = from_us;
  kept->to_us = from_us + reader->info().duration_us;
  kept->asset = announce->asset;
  kept->charged = file_cost(reader->info().whole_bytes);
  pin(*kept, 1);
  const std::lock_guard lock(mutex_);
  auto& all = kept_[reader->info().start.stream];
  all.insert(std::upper_bound(all.begin(), all.end(), from_us,
                              [](TimeUs at_us, const KeptPtr& one) { return at_us < one->from_us; }),
             kept);
}

/// The file of a session joins those kept.
void Recorder::keep(Session& session, const Item& announced, const std::string& path) {
  auto kept = std::make_shared<Kept>();
  kept->file = path;
  kept->asset = announced.announced.asset;
  kept->holder = announced.holder;
  kept->growing = true;
  kept->from_us = kept->to_us = session.start_unix_us;
  pin(*kept, 1);
  const std::lock_guard lock(mutex_);
  auto& all = kept_[session.stream];
  if (session.follows && !all.empty()) {
    all.back()->to_us = kept->from_us;
    all.back()->growing = false;
  }
  all.push_back(kept);
  session.kept = kept;
}

/// So many more of the files that are kept need an asset.
void Recorder::pin(const Kept& kept, int files) {
  const int before = pins_[kept.asset], after = pins_[kept.asset] += files;
  if (after == 0) pins_.erase(kept.asset);
  if ((before == 0) == (after == 0)) return;
  const std::string user = "~history/" + kept.asset;  // No stream's name.
  assets_.set_used(user, after == 0 ? std::nullopt : Sha256::from_hex(kept.asset), kept.holder);
}

void Recorder::remove_oldest() {
  if (settings_.keep_us == 0) return;
  for (;;) {
    KeptPtr gone;
    {
      const std::lock_guard lock(mutex_);
      const auto from = next_to_go(unix_from_steady(steady_now_us()));
      if (from == kept_.end()) return;
      gone = std::move(from->second.front());
      from->second.pop_front();
      if (from->second.empty()) kept_.erase(from);
      totals_.stored_bytes -= std::min(totals_.stored_bytes, gone->charged);
      std::uint64_t& held = holders_[gone->holder];
      held -= std::min(held, gone->charged);
    }
    holder_of_.erase(gone->file);
    pin(*gone, -1);
    std::error_code ignored;
    fs::remove(gone->file, ignored);
  }
}

/// The stream whose first file is over: by its age, or as the oldest of the holder of most, of those beyond their share
/// or, where there is too much, of all. REQUIRES: mutex_ is held.
auto Recorder::next_to_go(TimeUs now_us) -> decltype(kept_)::iterator {
  const auto max = static_cast<std::int64_t>(settings_.max_total_bytes);
  const auto stored = static_cast<std::int64_t>(totals_.stored_bytes);
  auto best = kept_.end();
  std::int64_t most = 0;
  for (auto it = kept_.begin(); it != kept_.end(); ++it) {
    const Kept& first = *it->second.front();
    if (first.growing) continue;
    const auto most_files = static_cast<std::size_t>(settings_.keep_us / kPieceUs) + kMorePieces;
    if (first.to_us < now_us - settings_.keep_us || it->second.size() > most_files) return it;
    const auto held = holders_.find(first.holder);
    const auto own = static_cast<std::int64_t>(held == holders_.end() ? 0 : held->second);
    const bool over = stored >= max || (!first.holder.empty() && own >= share_of(max, stored, own));
    if (!over || (best != kept_.end() && own < most)) continue;
    if (best != kept_.end() && own == most && best->second.front()->from_us <= first.from_us) continue;
    best = it;
    most = own;
  }
  return best;
}

/// Finds what others removed.
void Recorder::recount() {
  std::map<std::string, std::string> still_there;
  std::map<std::string, std::uint64_t> holders;
  std::uint64_t stored = 0;
  std::error_code error;
  for (fs::directory_iterator it(settings_.folder, error), end; !error && it != end; it.increment(error)) {
    const std::string path = it->path().string();
    std::error_code gone;
    const std::uint64_t size = fs::file_size(path, gone);
    if (gone || !path.ends_with(kSuffix)) continue;
    stored += file_cost(size);
    if (const auto known = holder_of_.find(path); known != holder_of_.end()) {
      holders[known->second] += file_cost(size);
      still_there.insert(*known);
    }
  }
  if (error) return;
  holder_of_.swap(still_there);
  const std::lock_guard lock(mutex_);
  totals_.stored_bytes = stored;
  holders_.swap(holders);
}

/// The quota that leaves this holder nothing; null: there is room. REQUIRES: mutex_ is held.
const char* Recorder::used_up(const std::string& holder) const {
  const auto max = static_cast<std::int64_t>(settings_.max_total_bytes);
  const auto stored = static_cast<std::int64_t>(totals_.stored_bytes);
  const auto held = holders_.find(holder);
  const auto own = static_cast<std::int64_t>(held == holders_.end() ? 0 : held->second);
  if (stored >= max) return "the recordings take all that recording.max_total_bytes allows";
  if (own < share_of(max, stored, own)) return nullptr;
  return "those of its sender's token or address take a quarter of what others leave of recording.max_total_bytes";
}

void Recorder::work(Item& item) {
  Session& session = *item.session;
  switch (item.kind) {
    case Item::Kind::kAnnounce:
      session.layout = item.layout;
      session.asset = item.announced.asset;
      if (session.writer) note(session);
      session.holder = item.holder;
      if (!session.writer) open(session, item);
      if (!session.writer) return;
      holder_of_[session.info.file] = item.holder;
      if (std::find(open_.begin(), open_.end(), item.session) == open_.end()) open_.push_back(item.session);
      return write_announcement(session, item);
    case Item::Kind::kKey:
      return write_key(item);
    case Item::Kind::kEnd:
      if (session.failed) return;
      if (session.writer) {
        const auto finished = session.writer->finish(settings_.keep_us == 0);
        if (!finished) return fail_session(session, finished.error());
        note(session);
        log(log_, info_level(),
            "recording of '" + session.stream + "' ended: " + session.info.file + ", " +
                std::to_string(session.info.frames) + " frames");
      }
      std::erase(open_, item.session);
      end_piece(session);
      return retire(session, RecordingInfo::State::kFinished);
  }
}

/// The last of its stream stays the growing one until the file is there that goes on.
void Recorder::end_piece(Session& session) {
  const std::lock_guard lock(mutex_);
  const auto all = kept_.find(session.stream);
  if (session.kept && !session.goes_on) session.kept->growing = false;
  if (!session.kept && session.follows && all != kept_.end()) all->second.back()->growing = false;
}

void Recorder::open(Session& session, const Item& announced) {
  if (session.failed) return;
  if (auto ready = assets_.make_writable(); !ready) return fail_session(session, ready.error());
  std::error_code ignored;
  fs::create_directories(settings_.folder, ignored);
  session.start_unix_us = static_cast<TimeUs>(unix_us());
  if (settings_.keep_us > 0) {
    session.start_us = announced.arrival_us;
    session.start_unix_us = unix_from_steady(announced.arrival_us);
    // After what is there, whatever became of the clock.
    const auto before = pieces(session.stream);
    if (!before.empty()) session.start_unix_us = std::max(session.start_unix_us, before.back().to_us + 1);
  }
  const std::string stem = settings_.folder + "/" + file_stem(session.stream);
  for (int number = 1; !session.writer; ++number) {
    const std::string path = stem + (number == 1 ? "" : "-" + std::to_string(number)) + std::string(kSuffix);
    auto made = recording::Writer::create(
        path, {session.stream, settings_.software, static_cast<std::uint64_t>(session.start_unix_us)});
    if (!made && made.error().code == ErrorCode::kRefused && number < 100) continue;
    if (!made) return fail_session(session, made.error());
    session.writer = std::move(*made);
    const std::lock_guard lock(mutex_);
    session.info.file = path;
    session.info.state = RecordingInfo::State::kRecording;
  }
  if (settings_.keep_us > 0) keep(session, announced, session.info.file);
  log(log_, info_level(), "recording '" + session.stream + "' into " + session.info.file);
}

/// With the memory that keys after it need. What is no longer written ends the session.
void Recorder::write_announcement(Session& session, const Item& item) {
  Bytes ids;
  if (item.memory) {
    for (const Generation::Segment& segment : item.memory->segments) {
      const Sha256 id = *Sha256::from_hex(segment.id);  // It was checked before it was remembered.
      if (!write_object(session, id, *segment.coded)) return;
      ids.insert(ids.end(), id.digest.begin(), id.digest.end());
    }
  }
  (void)session.writer->announce(session.writer->duration_us(), text_from_control(item.announced), ids);
  if (settings_.include_asset) write_asset(session);
}

/// Once each. False: nothing more is to be written.
bool Recorder::write_object(Session& session, const Sha256& id, ByteView bytes) {
  if (!session.objects.insert(id).second) return true;
  if (auto ok = session.writer->object(session.writer->duration_us(), id.digest, bytes); !ok) {
    fail_session(session, ok.error());
    return false;
  }
  note(session);
  const std::lock_guard lock(mutex_);
  session.object_bytes += bytes.size();
  return true;
}

void Recorder::write_asset(Session& session) {
  const auto id = Sha256::from_hex(session.asset);
  if (!id || session.objects.contains(*id)) return;
  const auto parts = assets_.references_of(*id);
  if (!parts) return log(log_, LogLevel::kWarning, "the asset is not in the recording: " + parts.error().message);
  std::vector<Sha256> all = *parts;
  all.push_back(*id);  // The manifest last, as in uploads.
  for (const Sha256& part : all) {
    if (session.objects.contains(part)) continue;
    const auto bytes = assets_.bytes_of(part);
    if (!bytes) return log(log_, LogLevel::kWarning, "the asset is not in the recording: " + bytes.error().message);
    if (!write_object(session, part, *bytes)) return;
    const std::lock_guard lock(mutex_);
    if (used_up(session.holder) != nullptr) return;  // flush_all() ends it.
  }
}

void Recorder::write_key(const Item& item) {
  Session& session = *item.session;
  if (!session.writer) return;
  if (session.start_us == 0) session.start_us = item.arrival_us;
  const TimeUs time_us = item.arrival_us - session.start_us;
  if (item.dropped > 0) {
    (void)session.writer->gap(time_us, item.dropped);
    const std::string dropped = std::to_string(item.dropped) + " frames dropped";
    log(log_, LogLevel::kWarning, "recording of '" + session.stream + "': the disk is behind, " + dropped);
  }
  if (!item.frame.empty()) (void)session.writer->frame(time_us, item.frame);
  if (item.state.after) {
    const auto join = item.state.join_frame(session.layout);
    if (!join) return fail_session(session, join.error());
    (void)session.writer->checkpoint(time_us, *join);
  }
}

void Recorder::flush_all(bool sync) {
  for (const SessionPtr& session : std::vector<SessionPtr>(open_)) {
    if (!session->writer) continue;
    const auto flushed = sync && settings_.keep_us == 0 ? session->writer->sync() : session->writer->flush();
    if (!flushed) {
      fail_session(*session, flushed.error());
      continue;
    }
    note(*session);
    if (settings_.keep_us > 0) continue;
    const std::lock_guard lock(mutex_);
    const char* why = used_up(session->holder);
    const auto found = sessions_.find(session->stream);
    if (why == nullptr || found == sessions_.end() || found->second != session) continue;
    log(log_, LogLevel::kError, "recording of '" + session->stream + "' stopped: " + why);
    end(session);
  }
}

void Recorder::note(Session& session) {
  const std::lock_guard lock(mutex_);
  const std::uint64_t bytes = session.writer->bytes();
  const std::uint64_t grown = file_cost(bytes) - std::exchange(session.charged, file_cost(bytes));
  totals_.bytes += bytes - std::exchange(session.written, bytes);
  totals_.stored_bytes += grown;
  holders_[session.holder] += grown;
  totals_.frames += session.writer->frames() - session.info.frames;
  session.info.bytes = session.writer->bytes();
  session.info.frames = session.writer->frames();
  session.info.duration_us = session.writer->duration_us();
  if (!session.kept) return;
  session.kept->to_us = session.kept->from_us + session.info.duration_us;
  session.kept->charged = session.charged;
}

void Recorder::fail_session(Session& session, const Error& error) {
  log(log_, LogLevel::kError, "recording of '" + session.stream + "' stopped, the stream goes on: " + error.message);
  session.writer.reset();
  end_piece(session);
  {
    const std::lock_guard lock(mutex_);
    session.failed = true;
    session.info.error = error.message;
    ++totals_.failed;
    const auto found = sessions_.find(session.stream);
    if (found != sessions_.end() && found->second.get() == &session) sessions_.erase(found);
    active_ = totals_.active = sessions_.size();
  }
  retire(session, RecordingInfo::State::kFailed);
  std::erase_if(open_, [&](const SessionPtr& open) { return open.get() == &session; });
}

void Recorder::retire(const Session& session, RecordingInfo::State state) {
  const std::lock_guard lock(mutex_);
  ended_.push_front(session.info);
  ended_.front().state = state;
  if (ended_.size() > kEndedKept) ended_.pop_back();
}

}  // namespace eigencast::broker
