// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>

#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast {

/// $EIGENCAST_CACHE, else $XDG_CACHE_HOME/eigencast, else ~/.cache/eigencast.
std::string default_cache_dir();

/// Objects by content hash in a folder. Every read is verified, a damaged object is removed and counts as absent;
class AssetCache {
 public:
  /// The folder is made when first written to; an empty name makes a cache that holds nothing.
  explicit AssetCache(std::string directory);
  std::optional<Bytes> load(const Sha256& id) const;
  Result<void> store(const Sha256& id, ByteView bytes) const;
  /// A small named record beside the objects, such as which manifest a bake gave.
  std::optional<Bytes> load_record(const std::string& name) const;
  Result<void> store_record(const std::string& name, ByteView bytes) const;

 private:
  std::string directory_;
};

}  // namespace eigencast
