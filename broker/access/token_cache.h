// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>

#include "broker/access/jwt.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

/// Claims of verified tokens by SHA-256 of the token, so that each is verified once and guesses take no room. Cleared
/// when full. Thread-safe.
class TokenCache {
 public:
  static constexpr std::size_t kMaxTokens = 4096;

  /// Nothing: unknown, expired or not yet valid.
  std::optional<Claims> find(const Sha256& token, std::int64_t leeway_s, std::int64_t now_unix_s);
  void keep(const Sha256& token, const Claims& claims);
  std::size_t size() const;

 private:
  mutable std::mutex mutex_;
  std::map<Sha256, Claims> claims_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
