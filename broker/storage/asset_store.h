// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "broker/relay/stream.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Objects (manifests and chunks) in a folder, each named by its SHA-256. Visible objects are complete and verified.
/// Layout: DIR/assets/ab/abcdef..., and DIR/assets/uploading/ for unverified or evicted files (emptied by open()).
///
/// When an upload needs space, the least recently used objects that no stream uses are evicted. A stream uses the asset
/// that it announced and every object whose 32-byte id occurs in it: chunks of a manifest stay without parsing it, at
/// worst too many (after Boehm and Weiser, "Garbage collection in an uncooperative environment", 1988).
///
/// Thread-safe, except that an Upload belongs to one thread at a time. Everything but contains() and the counters may
/// block on the disk.
class AssetStore final : public StreamTap {
 public:
  struct Settings {
    std::uint64_t max_object_bytes = 256u << 20;
    std::uint64_t max_total_bytes = std::uint64_t{16} << 30;
    /// Objects used within this time stay: a sender uploads its chunks before it announces them (default: 60 s).
    TimeUs min_idle_us = 60'000'000;
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
    Upload(AssetStore& store, const Sha256& expected, std::string path, FileHandle file);
    AssetStore& store_;
    Sha256 expected_;
    std::string path_;
    FileHandle file_;
    Sha256Stream hash_;
    std::uint64_t size_ = 0;
    bool kept_ = false;
  };

  struct Object {
    FileHandle file;
    std::uint64_t size = 0;
  };

  /// Errors: kIo, kRefused (another broker uses the folder).
  static Result<std::unique_ptr<AssetStore>> open(const std::string& data_dir, const Settings& settings);

  bool contains(const Sha256& id) const;
  /// Errors: kNotFound, kIo.
  Result<Object> read(const Sha256& id) const;
  /// Errors: kIo.
  Result<std::unique_ptr<Upload>> begin_upload(const Sha256& id);

  /// Protects the asset that `stream` uses and its objects from eviction. Nothing: the stream is removed.
  void set_used(std::string_view stream, const std::optional<Sha256>& asset);
  void on_announced(const Stream& stream) override;
  void on_key(const Stream&, const KeyRecordPtr&) override {}
  void on_stalled(const Stream&) override {}
  void on_forgotten(const Stream& stream) override;

  /// Errors: kNotFound, kIo.
  Result<Bytes> bytes_of(const Sha256& id) const;
  /// The stored objects whose ids occur in object `id`, in order of occurrence. Errors: kNotFound, kIo.
  Result<std::vector<Sha256>> references_of(const Sha256& id) const;

  std::uint64_t total_bytes() const { return total_bytes_; }
  std::size_t objects() const;
  std::uint64_t evicted() const { return evicted_; }
  const Settings& settings() const { return settings_; }

 private:
  struct Entry {
    std::uint64_t size = 0;
    TimeUs used_us = 0;     ///< On the steady clock; negative for uses before this process.
    TimeUs touched_us = 0;  ///< Last update of the file's times.
  };
  AssetStore(std::string root, const Settings& settings, FileHandle lock);
  Result<void> prepare();
  void find_objects(const std::string& folder);
  std::string path_of(const Sha256& id) const;
  std::set<Sha256> needed() const;
  /// Evicts objects until the store is within its quota or none is idle.
  void make_room();
  void evict(const Sha256& id, TimeUs used_us);  ///< Unless it was used since.
  /// Makes a verified file an object. False: it existed; counts as a use.
  Result<bool> admit(const Sha256& id, const std::string& verified, std::uint64_t size);
  std::string temporary_path();  ///< In the folder that open() empties.

  std::string root_;
  Settings settings_;
  FileHandle lock_;
  mutable std::mutex mutex_;
  mutable std::map<Sha256, Entry> entries_;                    // GUARDED_BY(mutex_)
  std::map<std::string, Sha256, std::less<>> used_by_stream_;  // GUARDED_BY(mutex_)
  std::mutex evicting_;                                        ///< Serialises make_room().
  std::atomic<std::uint64_t> evicted_{0};
  std::atomic<std::uint64_t> total_bytes_{0};  ///< Visible objects and uploads so far.
  std::atomic<std::uint64_t> temporaries_{0};  ///< Counter for file names.
};

}  // namespace eigencast::broker
