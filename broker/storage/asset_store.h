// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <limits>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "broker/relay/stream.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// What an object takes of the quota: blocks of the disk, and a share for its inode, its name and its entry in memory.
constexpr std::uint64_t charge_of(std::uint64_t bytes) {
  constexpr std::uint64_t kBlockBytes = 4096, kEntryBytes = 512;
  return (bytes + kBlockBytes - 1) / kBlockBytes * kBlockBytes + kEntryBytes;
}

/// Objects (manifests and chunks) in a folder, each named by its SHA-256. What is read is complete and verified: a file
/// that a disk has torn is none, and the next upload replaces it.
/// Layout: DIR/assets/ab/abcdef..., and DIR/assets/uploading/ for unverified or evicted files (emptied by open()).
///
/// When an upload needs space, the least recently used objects that no stream uses are evicted; those of a holder
/// beyond its share, half of the store, before all others, in use or not, unless it is the one that uploads; where all
/// else is in use, those of the holder of most, for one that holds less. What streams of others use is then charged to
/// one of these instead, as long as its share has room: nobody loses what it uses because others stored too much, and
/// nobody pays for what it neither stored nor uses. A stream uses the asset that it announced and every object that
/// this lists, as note_uses() finds; all else costs the same for any number of streams. It uses the segments of its
/// memory, too: poses of people, which are removed some time after no stream remembers them.
///
/// Thread-safe, except that an Upload belongs to one thread at a time. Everything but contains() and the counters may
/// block on the disk.
class AssetStore final : public StreamTap {
 public:
  struct Settings {
    std::uint64_t max_object_bytes = 256u << 20;
    std::uint64_t max_total_bytes = std::uint64_t{16} << 30;  ///< Of charge_of().
    std::uint64_t max_objects = 100'000;
    /// Objects used within this time stay: a sender uploads its chunks before it announces them (default: 60 s).
    TimeUs min_idle_us = 60'000'000;
  };

  /// A client that objects are charged to.
  struct Holder {
    std::string name;
    std::uint64_t bytes = 0, objects = 0;                         ///< As charged, uploads under way included.
    double load = 0;                                              ///< What part of the store that is.
    std::list<Sha256> order{};                                    ///< By last use, oldest first.
    bool is_over() const { return !name.empty() && load > 0.5; }  ///< Beyond its share.
  };

  /// Leaves nothing behind unless commit() succeeds.
  class Upload {
   public:
    ~Upload();
    /// Errors: kTooLarge (object), kIo (a full store or disk).
    Result<void> write(ByteView data);
    /// Verifies the object and makes it durable and visible. True: new; false: it existed. Blocks on the disk.
    /// Errors: kCorrupt (wrong hash), kIo.
    Result<bool> commit();

   private:
    friend class AssetStore;
    Upload(AssetStore& store, const Sha256& expected, std::string_view holder);
    Result<void> grow(std::uint64_t bytes);  ///< Charges for them.
    AssetStore& store_;
    Sha256 expected_;
    Holder* holder_;
    std::string path_;
    FileHandle file_{};
    Sha256Stream hash_;
    std::uint64_t size_ = 0;
    std::uint64_t charge_ = 0;
    bool kept_ = false;
  };

  struct Object {
    FileHandle file;
    std::uint64_t size = 0;
    bool is_segment = false;  ///< Of a memory of poses: nobody else is to keep it.
  };

  /// A folder that takes no files serves what it has. Errors: kRefused (another broker uses the folder).
  static Result<std::unique_ptr<AssetStore>> open(const std::string& data_dir, const Settings& settings);
  /// Whether files may be written into the data folder: locks it if that failed before. Errors, which name the path:
  /// kIo, kRefused (another broker uses it by now).
  Result<void> make_writable();

  bool contains(const Sha256& id) const;
  /// Errors: kNotFound, kIo.
  Result<Object> read(const Sha256& id) const;
  /// `holder`: the client that the object is charged to; empty: none. Errors: kIo (also a full store).
  Result<std::unique_ptr<Upload>> begin_upload(const Sha256& id, std::string_view holder = {});

  /// Protects the asset that `stream` of `holder` (empty: none) uses and its objects from eviction. Nothing: the stream
  /// is removed.
  void set_used(std::string_view stream, const std::optional<Sha256>& asset, std::string_view holder = {});
  void on_announced(const Stream& stream) override;
  void on_key(const Stream&, const KeyRecordPtr&) override {}
  void on_stalled(const Stream&) override {}
  void on_memory(const Stream& stream) override;
  void on_forgotten(const Stream& stream) override;

  /// Errors: kNotFound, kIo.
  Result<Bytes> bytes_of(const Sha256& id) const;
  /// The stored objects that object `id` lists, once each, in its order, if it is a manifest. A use of them. Errors:
  /// kNotFound, kIo.
  Result<std::vector<Sha256>> references_of(const Sha256& id) const;
  /// Reads what streams use, each asset three times in min_idle_us, or once it is announced: a use of what it lists.
  /// What streams may have begun to use since is not evicted as idle: call it every second, on one thread that nobody
  /// waits for.
  void note_uses();
  /// No upload could begin a file, nor can any since.
  bool fails() const { return fails_; }

  // Visible objects and uploads so far.
  std::uint64_t total_bytes() const { return total_bytes_; }  ///< As charged.
  std::uint64_t objects() const { return objects_; }
  std::uint64_t evicted() const { return evicted_; }
  const Settings& settings() const { return settings_; }

 private:
  static constexpr TimeUs kNever = std::numeric_limits<TimeUs>::min() / 2;
  /// Of a file that was found at the start its hash says what it is, when it is first read.
  enum class Content : std::uint8_t { kUnread, kWhole, kTorn };
  struct Entry {
    std::uint64_t size = 0;
    TimeUs used_us = 0;       ///< On the steady clock; negative for uses before this process.
    TimeUs touched_us = 0;    ///< Last update of the file's times.
    TimeUs read_us = kNever;  ///< When note_uses() last did.
    Holder* holder = nullptr;
    bool is_durable = true;  ///< Found at the start, or synced.
    Content content = Content::kWhole;
    std::string user{};  ///< Another holder whose stream uses it, the one that is charged least; empty: none known.
    TimeUs user_us = 0;  ///< When that was found.
    std::list<Sha256>::iterator order{}, held{};  ///< In order_, and in the holder's.
  };
  struct Used {
    Sha256 asset;
    std::string holder;
    std::vector<Sha256> segments{};  ///< Counted in segment_uses_.
  };
  using Users = std::set<std::pair<double, std::string>>;  ///< Names of holders, by load().
  struct SegmentUse {
    std::uint32_t streams = 0;
    TimeUs since_us = 0;  ///< When it came to be of no stream.
    bool queued = false;  ///< In forgotten_.
  };
  /// Keyed: senders choose ids, and could choose them for one bucket.
  struct IdHash {
    std::size_t operator()(const Sha256& id) const;
  };
  AssetStore(const std::string& data_dir, const Settings& settings);
  void load();
  std::string path_of(const Sha256& id) const;
  void use(Entry& entry, TimeUs now_us) const;  ///< REQUIRES: mutex_.
  bool is_over() const;
  /// Streams of these use it; its holder passes it on if it is beyond its share.
  void note_users(const Sha256& id, const Users& users, TimeUs now_us);
  /// Charges it to its user instead. False: none is known by now, or its share has no room. REQUIRES: mutex_.
  bool pass_on(Entry& entry);
  /// What part of the store a holder is charged for. REQUIRES: mutex_.
  double load(const std::string& name) const;
  void forget_segments(const std::vector<Sha256>& segments);  ///< REQUIRES: mutex_.
  void remove_forgotten(TimeUs now_us);
  bool evict_oldest(const Holder& wanting);  ///< False: the store is within its quota, or none is idle.
  Holder& holder(std::string_view name);     ///< REQUIRES: mutex_, and that it is charged before others.
  /// Counts bytes and an object, or takes them back; then a holder of nothing is forgotten. REQUIRES: mutex_.
  void charge(Holder& holder, std::int64_t bytes, int objects);
  void count(Holder& holder, std::int64_t bytes, int objects);  ///< The same without the totals.
  bool is_durable(const Sha256& id);                            ///< A use of it.
  void note_durable(const Sha256& id);
  void insert(const Sha256& id, Entry entry);  ///< As the one used last. REQUIRES: mutex_, and that it is charged.
  void erase(std::unordered_map<Sha256, Entry, IdHash>::iterator entry);  ///< REQUIRES: mutex_.
  /// Reads a file that nobody has read since the start. False: it is not what its name says. Errors: kIo.
  Result<bool> check(const Sha256& id, int file) const;
  Error note_gone(const Sha256& id) const;
  /// Makes a verified file an object. False: it existed; counts as a use.
  Result<bool> admit(const Sha256& id, const std::string& verified, std::uint64_t size, Holder& holder);
  std::string temporary_path();  ///< In the folder that open() empties.
  /// A new file there, in folders made anew where others removed them. Negative: errno says why.
  FileHandle make_file(const std::string& path);

  std::string data_dir_, root_;
  Settings settings_;
  std::mutex locking_;
  FileHandle lock_;  ///< GUARDED_BY(locking_)
  mutable std::mutex mutex_;
  mutable std::unordered_map<Sha256, Entry, IdHash> entries_;    // GUARDED_BY(mutex_)
  mutable std::list<Sha256> order_;                              ///< By last use, oldest first. GUARDED_BY(mutex_)
  std::map<std::string, Used, std::less<>> used_by_stream_;      // GUARDED_BY(mutex_)
  std::unordered_map<Sha256, SegmentUse, IdHash> segment_uses_;  // GUARDED_BY(mutex_)
  std::deque<std::pair<Sha256, TimeUs>> forgotten_;              ///< When to look at what was. GUARDED_BY(mutex_)
  std::map<std::string, Holder, std::less<>> holders_;           // GUARDED_BY(mutex_)
  std::set<std::pair<double, const Holder*>> by_load_;           // GUARDED_BY(mutex_)
  std::atomic<TimeUs> noted_us_{kNever};                         ///< note_uses() has noted all uses at that time.
  std::atomic<std::uint64_t> evicted_{0};
  std::atomic<std::uint64_t> total_bytes_{0};
  std::atomic<std::uint64_t> objects_{0};
  std::atomic<std::uint64_t> temporaries_{0};  ///< Counter for file names.
  std::atomic<bool> fails_{false};
};

}  // namespace eigencast::broker
