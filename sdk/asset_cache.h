// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>

#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast {

std::string default_cache_dir();  ///< $EIGENCAST_CACHE, else $XDG_CACHE_HOME/eigencast, else ~/.cache/eigencast.

/// Objects by content hash in a folder. Every read is verified, a damaged object is removed and counts as absent;
class AssetCache {
 public:
  /// The folder is made when first written to; an empty name makes a cache that holds nothing.
  explicit AssetCache(std::string directory);
  std::optional<Bytes> load(const Sha256& id) const;
  Result<void> store(const Sha256& id, ByteView bytes) const;
  /// A small record beside the objects: what a bake gave, under the hash of what it was made of.
  std::optional<Bytes> load_record(const Sha256& key) const;
  Result<void> store_record(const Sha256& key, ByteView bytes) const;

 private:
  std::string directory_;
};

}  // namespace eigencast
