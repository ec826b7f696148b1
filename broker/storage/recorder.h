// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
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

/// Records streams into files (docs/recording-format.md), one file each, on its own thread.
/// Keys beyond the bound of the queue, or their holder's share_of() it, are dropped, counted, logged and bridged by a
/// checkpoint: recording never delays a frame. If the disk fails or is full, or a quota is used up, the recording ends
/// and streaming continues. Files of earlier runs count towards the quota of all, and are no holder's. Thread-safe.
class Recorder final : public StreamTap {
 public:
  struct Settings {
    std::string folder;
    std::string software;        ///< Writing software, as named in the files.
    StreamPatterns streams;      ///< Streams recorded whenever they are live.
    bool include_asset = false;  ///< Include the asset's objects.
    std::int64_t max_queued_bytes = 16 << 20;
    std::uint64_t max_total_bytes = std::uint64_t{64} << 30;  ///< For all in the folder; one holder's: share_of() it.
  };
  struct Totals {
    std::uint64_t active = 0;
    std::uint64_t failed = 0;
    std::uint64_t frames = 0;
    std::uint64_t dropped = 0;
    std::uint64_t bytes = 0;  ///< Written in this run.
    std::int64_t queued_bytes = 0;
    std::uint64_t stored_bytes = 0;  ///< All files in the folder as the quotas count them, anew each minute.
  };

  /// Starts the thread, which first repairs recordings torn by a crash.
  Recorder(Settings settings, AssetStore& assets, LogSink log);
  ~Recorder() override;  ///< Finishes all recordings.

  /// Records `stream` from its next key; the stream may not exist yet. REQUIRES: check_stream_name passed.
  /// Errors: kRefused (it is being recorded), kTooLarge (quota used up).
  Result<void> start(std::string_view stream);
  /// Errors: kNotFound (it is not being recorded).
  Result<void> stop(std::string_view stream);
  /// Active recordings, then the last ended ones, latest first.
  std::vector<RecordingInfo> list() const;
  Totals totals() const;

  void on_announced(const Stream& stream) override;
  void on_key(const Stream& stream, const KeyRecordPtr& record) override;
  void on_stalled(const Stream& stream) override;
  void on_forgotten(const Stream&) override {}

 private:
  struct Session;
  struct Item;
  using SessionPtr = std::shared_ptr<Session>;

  SessionPtr add(std::string_view stream, bool automatic);
  void push(Item item);
  void announce(const SessionPtr& session, const Stream& stream);
  void end(const SessionPtr& session);
  void run();
  void repair();
  void recount();
  const char* used_up(const std::string& holder) const;
  void work(Item& item);
  void open(Session& session);
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
  std::atomic<std::uint64_t> active_{0};          ///< Zero lets on_key() return at once.

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_), all that follows.
  std::condition_variable stop_;
  std::map<std::string, SessionPtr, std::less<>> sessions_;
  std::deque<Item> queue_;
  std::map<std::string, std::int64_t> queued_;  ///< Bytes of it, by holder.
  std::deque<RecordingInfo> ended_;
  Totals totals_;
  std::map<std::string, std::uint64_t> holders_;  ///< What their recordings are charged.
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace eigencast::broker
