// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "broker/access/patterns.h"
#include "broker/access/signature.h"
#include "common/core/hash/sha256.h"

/// Signed tokens: JSON Web Tokens (RFC 7519) in the compact form (RFC 7515), restricted as RFC 8725 recommends.
///
///   header   {"alg":"ES256","kid":"main","typ":"JWT"}
///   claims   {"sub":"camera-1","aud":"eigencast","exp":1700000000,
///             "eigencast":{"pub":["lab/**"],"sub":["**"],"speak":["**"],"rewind":["**"],"admin":false}}
namespace eigencast::broker {

inline constexpr std::size_t kMaxTokenBytes = 8 * 1024;

struct Claims {
  std::string subject;                       ///< "sub"; may be empty.
  std::string key_id;                        ///< Id of the signing key.
  std::int64_t expires_s = 0;                ///< "exp", Unix seconds.
  std::optional<std::int64_t> not_before_s;  ///< "nbf"
  Rights rights;
};

struct TokenRules {
  std::vector<TokenKey> keys;
  std::string audience;       ///< Must be in "aud"; empty: any.
  std::string issuer;         ///< Must be "iss"; empty: any.
  std::int64_t leeway_s = 0;  ///< Accepted clock difference.
};

/// Safe on hostile input. Errors: kRefused; the message gives the reason.
Result<Claims> verify_token(std::string_view token, const TokenRules& rules, std::int64_t now_unix_s);

/// Claims of verified tokens by SHA-256 of the token, so that each is verified once and guesses take no room. Cleared
/// when full. Thread-safe.
class TokenCache {
 public:
  static constexpr std::size_t kMaxTokens = 4096;

  /// Nothing: unknown, expired or not yet valid.
  std::optional<Claims> find(const Sha256& token, std::int64_t leeway_s, std::int64_t now_unix_s);
  void keep(const Sha256& token, const Claims& claims);

 private:
  std::mutex mutex_;
  std::map<Sha256, Claims> claims_;  ///< GUARDED_BY(mutex_)
};

struct TokenRequest {
  std::string subject;
  std::string audience;
  std::string issuer;
  std::vector<std::string> publish;
  std::vector<std::string> subscribe;
  bool admin = false;
  std::int64_t issued_s = 0;
  std::int64_t expires_s = 0;
  std::vector<std::string> speak{};
  std::vector<std::string> rewind{};
};
/// Errors: kInvalidArgument (patterns), and those of TokenKey::sign().
Result<std::string> create_token(const TokenRequest& request, const TokenKey& key);

/// Header and claims as JSON text, unverified, for display. Errors: kCorrupt.
struct TokenParts {
  std::string header;
  std::string claims;
};
Result<TokenParts> read_token(std::string_view token);

}  // namespace eigencast::broker
