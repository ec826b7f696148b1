// SPDX-License-Identifier: MIT
// What a recorder's thread writes, file by file.
#include <algorithm>
#include <ctime>
#include <filesystem>
#include <utility>

#include "broker/storage/recorder_parts.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kEndedKept = 100;
constexpr int kMaxNames = 1000;  ///< Of files of a stream that begin in a second.

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

void Recorder::work(Item& item) {
  Session& session = *item.session;
  switch (item.kind) {
    case Item::Kind::kAnnounce:
      session.layout = item.begins->layout;
      session.asset = item.begins->announced.asset;
      if (session.writer) note(session);
      session.holder = item.begins->holder;
      if (settings_.keep_us > 0 && !session.holder.empty()) {
        session.holder = sha256(session.holder).hex().substr(0, kHolderDigits);
      }
      if (!session.writer) open(session, item);
      if (!session.writer) return;
      holder_of_[session.info.file] = session.holder;
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
  const auto [goes_on, follows] = [&] {
    const std::lock_guard lock(mutex_);
    return std::pair(session.goes_on, session.follows);
  }();
  const std::lock_guard lock(kept_mutex_);
  const auto all = kept_.find(session.stream);
  if (session.kept && !goes_on) session.kept->growing = false;
  if (!session.kept && follows && all != kept_.end()) all->second.back()->growing = false;
}

void Recorder::open(Session& session, const Item& announced) {
  if (session.failed) return;
  if (auto ready = assets_.make_writable(); !ready) return fail_session(session, ready.error());
  std::error_code ignored;
  fs::create_directories(settings_.folder, ignored);
  session.start_unix_us = static_cast<TimeUs>(unix_now_us());
  if (settings_.keep_us > 0) {
    session.start_us = announced.arrival_us;
    session.start_unix_us = unix_from_steady(announced.arrival_us);
    // After what is there, whatever became of the clock.
    const auto before = pieces(session.stream);
    if (!before.empty()) session.start_unix_us = std::max(session.start_unix_us, before.back().to_us + 1);
  }
  std::string stem = settings_.folder + "/" + file_stem(session.stream);
  if (settings_.keep_us > 0 && !session.holder.empty()) stem += "." + session.holder;
  for (int number = 1; !session.writer; ++number) {
    const std::string path = stem + (number == 1 ? "" : "-" + std::to_string(number)) + std::string(kRecordingSuffix);
    auto made = recording::Writer::create(
        path, {session.stream, settings_.software, static_cast<std::uint64_t>(session.start_unix_us)});
    if (!made && made.error().code == ErrorCode::kRefused && number < kMaxNames) continue;
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
  if (const GenerationPtr& memory = item.begins->memory) {
    for (const Generation::Segment& segment : memory->segments) {
      const Sha256 id = *Sha256::from_hex(segment.id);  // It was checked before it was remembered.
      if (!write_object(session, id, *segment.coded)) return;
      ids.insert(ids.end(), id.digest.begin(), id.digest.end());
    }
  }
  (void)session.writer->announce(session.writer->duration_us(), text_from_control(item.begins->announced), ids);
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
  if (session.writer->frames() > 0) session.resume_us = 0;
  totals_.frames += session.writer->frames() - session.info.frames;
  session.info.bytes = session.writer->bytes();
  session.info.frames = session.writer->frames();
  session.info.duration_us = session.writer->duration_us();
  if (!session.kept) return;
  const std::lock_guard lock_kept(kept_mutex_);
  session.kept->to_us = session.kept->from_us + session.info.duration_us;
  session.kept->charged = session.charged;
}

void Recorder::fail_session(Session& session, const Error& error) {
  log(log_, LogLevel::kError,
      "recording of '" + session.stream + "' stopped, the stream goes on: " + error.message +
          (settings_.keep_us > 0 ? "; it is tried again" : ""));
  session.writer.reset();
  end_piece(session);
  {
    const std::lock_guard lock(mutex_);
    session.failed = true;
    session.info.error = error.message;
    ++totals_.failed;
    const auto found = sessions_.find(session.stream);
    if (found != sessions_.end() && found->second.get() == &session) {
      sessions_.erase(found);
      if (settings_.keep_us > 0) add(session.stream, true)->resume_us = steady_now_us() + settings_.retry_us;
    }
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
