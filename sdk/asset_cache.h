// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>

#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast {

std::string default_cache_dir();  ///< $EIGENCAST_CACHE, else $XDG_CACHE_HOME/eigencast, else ~/.cache/eigencast.

std::uint64_t default_cache_bytes();  ///< $EIGENCAST_CACHE_BYTES, else 4 GiB.

/// Objects by content hash in a folder. Every read is verified, a damaged object is removed and counts as absent; when
/// the folder is full, what was unused for longest goes. Thread-safe; processes may share a folder.
class AssetCache {
 public:
  /// The folder is made when first written to; an empty name makes a cache that holds nothing.
  /// max_bytes  of all files, each in blocks of the disk; what is larger by itself is not kept
  explicit AssetCache(std::string directory, std::uint64_t max_bytes = default_cache_bytes());
  std::optional<Bytes> load(const Sha256& id) const;
  Result<void> store(const Sha256& id, ByteView bytes) const;
  /// A small record beside the objects: what a bake gave, under the hash of what it was made of.
  std::optional<Bytes> load_record(const Sha256& key) const;
  Result<void> store_record(const Sha256& key, ByteView bytes) const;

 private:
  void make_room(std::uint64_t written) const;

  const std::string directory_;
  const std::uint64_t max_bytes_;
  mutable std::atomic<std::uint64_t> unchecked_;  ///< Bytes written since the folder was looked through.
};

}  // namespace eigencast
