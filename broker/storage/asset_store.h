// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// A file descriptor that is closed at the end of its life.
class FileHandle {
 public:
  explicit FileHandle(int fd = -1) : fd_(fd) {}
  ~FileHandle();
  FileHandle(FileHandle&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileHandle& operator=(FileHandle&& other) noexcept;
  int get() const { return fd_; }

 private:
  int fd_;
};

/// Objects (manifests and chunks) in a folder, each named by its SHA-256. What is visible is whole and has that hash.
///
/// Layout: DIR/assets/ab/abcdef...  and DIR/assets/uploading/ for what is not verified yet (emptied at opening).
/// Thread-safe, except that one Upload belongs to one thread at a time.
class AssetStore {
 public:
  struct Settings {
    std::uint64_t max_object_bytes = 256u << 20;
    std::uint64_t max_total_bytes = std::uint64_t{16} << 30;
  };

  /// An object on its way in. Nothing of it stays unless commit() succeeds.
  class Upload {
   public:
    ~Upload();
    Upload(const Upload&) = delete;
    Upload& operator=(const Upload&) = delete;

    /// Errors: kTooLarge (object or store), kIo (message names the cause, for example a full disk).
    Result<void> write(ByteView data);
    /// Verifies, makes durable and visible. True: it is new; false: it was there already. Blocks on the disk.
    /// Errors: kCorrupt (another hash), kIo.
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

  /// Makes the folders. Errors: kIo, kRefused (another broker uses the folder).
  static Result<std::unique_ptr<AssetStore>> open(const std::string& data_dir, const Settings& settings);
  ~AssetStore();

  bool contains(const Sha256& id) const;
  /// Errors: kNotFound, kIo.
  Result<Object> read(const Sha256& id) const;
  /// Errors: kIo.
  Result<std::unique_ptr<Upload>> begin_upload(const Sha256& id);

  std::uint64_t total_bytes() const { return total_bytes_; }
  const Settings& settings() const { return settings_; }

 private:
  AssetStore(std::string root, const Settings& settings, FileHandle lock);
  Result<void> prepare();
  std::string path_of(const Sha256& id) const;

  std::string root_;
  Settings settings_;
  FileHandle lock_;
  std::atomic<std::uint64_t> total_bytes_{0};  ///< Visible objects and uploads so far.
  std::atomic<std::uint64_t> uploads_{0};      ///< Gives temporary names.
};

}  // namespace eigencast::broker
