// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "broker/access/patterns.h"
#include "broker/relay/stream.h"
#include "broker/storage/asset_store.h"
#include "common/core/fair_queue.h"
#include "common/core/log.h"
#include "common/core/text.h"

namespace eigencast::broker {

struct RecordingInfo {
  enum class State : std::uint8_t { kWaiting, kRecording, kFinished, kFailed };
  std::string stream;
  std::string file;  ///< Empty until its first key.
  State state = State::kWaiting;
  std::string error;  ///< Why it failed.
  std::uint64_t bytes = 0;
  std::uint64_t frames = 0;
  std::uint64_t dropped = 0;  ///< Dropped because the disk was too slow.
  TimeUs duration_us = 0;
};
inline constexpr EnumNames<RecordingInfo::State, 4> kRecordingStates{{"waiting", "recording", "finished", "failed"}};

/// Records streams into files (docs/recording-format.md), one file each, on its own thread. Where it keeps the last of
/// them only, its files are short, the oldest go, and the store keeps the assets that they need.
/// Keys beyond the bound of the queue, or their holder's share_of() it, are dropped, counted, logged and bridged by a
/// checkpoint: recording never delays a frame; announcements of surfaces wait for a key that is not. Holders have fair
/// turns of the thread, and shares of the files that begin in a second where they are kept. If the disk fails or is
/// full, or a quota is used up, the recording ends and streaming continues. Files of earlier runs count towards the
/// quota of all; those kept towards their holder's, of whom their names have a hash, others towards nobody's.
/// Thread-safe.
class Recorder final : public StreamTap {
 public:
  struct Settings {
    std::string folder;
    std::string software;                  ///< Writing software, as named in the files.
    StreamPatterns streams;                ///< Streams recorded whenever they are live.
    bool include_asset = false;            ///< Include the asset's objects.
    std::int64_t max_kept_streams = 4096;  ///< Of which anything is kept; one holder's: share_of() it.
    std::int64_t max_queued_bytes = 16 << 20;
    std::uint64_t max_total_bytes = std::uint64_t{64} << 30;  ///< For all in the folder; one holder's: share_of() it.
    TimeUs checkpoint_us = 1'000'000;                         ///< From one checkpoint to the next, at most,
    std::uint64_t checkpoint_keys = 2'000;                    ///< and so many keys.
    /// Not 0: only so much is kept, and no more than max_total_bytes; nothing is ended for that, nor synced.
    TimeUs keep_us = 0;
    TimeUs retry_us = 10'000'000;  ///< What is kept goes on so long after the disk has failed.
  };
  /// A file of those kept, in microseconds since 1970.
  struct Piece {
    std::string file;
    TimeUs from_us = 0, to_us = 0;  ///< From its first pose to its last, or to where the next file goes on.
    bool growing = false;
  };
  struct Totals {
    std::uint64_t active = 0;
    std::uint64_t failed = 0;
    std::uint64_t failing = 0;  ///< Streams of which nothing is kept until the disk takes files again.
    std::uint64_t frames = 0;
    std::uint64_t dropped = 0;
    std::uint64_t bytes = 0;  ///< Written in this run.
    std::int64_t queued_bytes = 0;
    std::uint64_t stored_bytes = 0;  ///< All files in the folder as the quotas count them, anew each minute.
  };

  /// Starts the thread, which first repairs recordings torn by a crash.
  Recorder(Settings settings, AssetStore& assets, LogSink log);
  ~Recorder() override;  ///< Finishes all recordings.

  /// The end comes soon: what is not written by then, on the steady clock, is left out, counted and logged.
  void end_by(TimeUs end_us);

  /// Records `stream` from its next key; the stream may not exist yet. REQUIRES: check_stream_name passed.
  /// Errors: kRefused (it is being recorded), kTooLarge (quota used up).
  Result<void> start(std::string_view stream);
  /// Errors: kNotFound (it is not being recorded).
  Result<void> stop(std::string_view stream);
  /// Active recordings, then the last ended ones, latest first.
  std::vector<RecordingInfo> list() const;
  Totals totals() const;
  /// What is kept of a stream, ascending.
  std::vector<Piece> pieces(std::string_view stream) const;
  /// Whether it is to be kept.
  bool keeps(std::string_view stream) const { return settings_.keep_us > 0 && settings_.streams.matches(stream); }
  /// A time of the steady clock in microseconds since 1970, by what the system's clock said at the start.
  TimeUs unix_from_steady(TimeUs steady_us) const { return steady_us + unix_ahead_us_; }

  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_forgotten(const Stream&) override {}

 private:
  struct Session;
  struct Item;
  struct Kept : Piece {
    std::string asset;
    std::string holder;  ///< Hashed. Empty: nobody.
    std::uint64_t charged = 0;
  };
  using KeptPtr = std::shared_ptr<Kept>;
  using SessionPtr = std::shared_ptr<Session>;

  SessionPtr add(std::string_view stream, bool automatic);
  /// False: it has its holder's share of the queue already.
  bool push(Item item, std::int64_t bytes, std::int64_t max_bytes);
  /// Likewise.
  /// first_us  arrival of the session's first key, where it is announced with that
  bool announce(const SessionPtr& session, const Stream& stream, TimeUs first_us = 0);
  bool may_begin(const std::string& holder, TimeUs now_us);
  bool is_full(const Session& session, TimeUs arrival_us) const;
  void end(const SessionPtr& session);
  void run();
  bool work_until(TimeUs until_us);
  void leave_rest();
  void repair();
  void restore(const std::string& path);
  void keep(Session& session, const Item& announced, const std::string& path);
  bool remove_oldest(TimeUs until_us);
  void remove(const Kept& gone);
  std::vector<std::string> streams_to_shorten(TimeUs now_us) const;
  void pin(const std::string& asset, int files, const std::string& holder = {});
  void recount();
  const char* used_up(const std::string& holder) const;
  void work(Item& item);
  void end_piece(Session& session);
  void open(Session& session, const Item& announced);
  /// Of what is kept nobody wants to read of each file.
  LogLevel info_level() const { return settings_.keep_us > 0 ? LogLevel::kDebug : LogLevel::kInfo; }
  bool write_object(Session& session, const Sha256& id, ByteView bytes);
  void write_asset(Session& session);
  void write_announcement(Session& session, const Item& item);
  void write_key(const Item& item);
  void flush_all(bool sync);
  void fail_session(Session& session, const Error& error);
  void retire(const Session& session, RecordingInfo::State state);
  void note(Session& session);

  const Settings settings_;
  AssetStore& assets_;
  const LogSink log_;
  std::vector<SessionPtr> open_;                  ///< Belongs to the thread: sessions with open files.
  std::map<std::string, std::string> holder_of_;  ///< Belongs to the thread: holders by file.
  /// Belongs to the thread: of an earlier run, from after now. They go first where bytes lack, and are kept once the
  /// broker starts later than they begin.
  std::vector<KeptPtr> ahead_;
  std::map<std::string, int> pins_;  ///< Belongs to the thread: files that need an asset.
  const TimeUs unix_ahead_us_;
  std::atomic<std::uint64_t> active_{0};  ///< Zero lets on_key() return at once.

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_), all that follows.
  std::condition_variable stop_;
  std::map<std::string, SessionPtr, std::less<>> sessions_;
  FairQueue<Item> queue_;                      ///< Costs are bytes.
  TimeUs second_us_ = 0;                       ///< Since then,
  std::map<std::string, std::int64_t> begun_;  ///< so many files have begun, by holder,
  std::int64_t all_begun_ = 0;                 ///< and in all.
  std::deque<RecordingInfo> ended_;
  Totals totals_;
  std::map<std::string, std::uint64_t> holders_;  ///< What their recordings are charged.
  bool stopping_ = false;
  TimeUs end_us_ = std::numeric_limits<TimeUs>::max();

  /// Not on the loop for each key, as many names take long to look through; locked behind mutex_.
  mutable std::mutex kept_mutex_;
  std::map<std::string, std::deque<KeptPtr>, std::less<>> kept_;  ///< By stream, ascending. GUARDED_BY(kept_mutex_)
  std::thread thread_;
};

}  // namespace eigencast::broker
