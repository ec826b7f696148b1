// SPDX-License-Identifier: MIT
#include "broker/access/token_cache.h"

namespace eigencast::broker {

std::optional<Claims> TokenCache::find(const Sha256& token, std::int64_t leeway_s, std::int64_t now_unix_s) {
  const std::lock_guard lock(mutex_);
  const auto found = claims_.find(token);
  if (found == claims_.end()) return std::nullopt;
  const Claims& claims = found->second;
  const bool over = now_unix_s >= claims.expires_s + leeway_s;
  const bool early = claims.not_before_s && now_unix_s + leeway_s < *claims.not_before_s;
  if (!over && !early) return claims;
  claims_.erase(found);
  return std::nullopt;
}

void TokenCache::keep(const Sha256& token, const Claims& claims) {
  const std::lock_guard lock(mutex_);
  if (claims_.size() >= kMaxTokens) claims_.clear();
  claims_.insert_or_assign(token, claims);
}

std::size_t TokenCache::size() const {
  const std::lock_guard lock(mutex_);
  return claims_.size();
}

}  // namespace eigencast::broker
