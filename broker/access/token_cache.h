// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>

#include "broker/access/jwt.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

/// What signed tokens said that were checked before, by the SHA-256 of the whole token: who comes again with the same
/// one need not have it parsed and verified again. Holds good ones only, so that guesses take no room; bounded: when it
/// is full it begins anew. Belongs to one set of rules and goes with it when the configuration is reloaded.
/// Thread-safe.
class TokenCache {
 public:
  static constexpr std::size_t kMost = 4096;

  /// Nothing: not known, or its times are not those of a valid token now.
  std::optional<Claims> find(const Sha256& token, std::int64_t leeway_s, std::int64_t now_unix_s);
  void keep(const Sha256& token, const Claims& claims);
  std::size_t size() const;

 private:
  mutable std::mutex mutex_;
  std::map<Sha256, Claims> claims_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
