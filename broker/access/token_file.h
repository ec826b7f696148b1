// SPDX-License-Identifier: MIT
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "broker/access/patterns.h"
#include "common/core/hash/sha256.h"

/// Fixed tokens, without keys and clocks, for small set-ups: a file with one line per token, which holds only its hash.
///
///   # a comment
///   NAME sha256:64-HEX-DIGITS [pub=PATTERN,PATTERN] [sub=PATTERN,...] [speak=PATTERN,...] [rewind=PATTERN,...] [admin]
///
/// A token has 256 random bits, so one round of SHA-256 is enough.
namespace eigencast::broker {

struct StaticToken {
  std::string name;
  Rights rights;
};

class TokenFile {
 public:
  static constexpr std::size_t kMaxTokens = 10'000;

  TokenFile() = default;
  /// Errors: kInvalidArgument, with `name` and line: malformed, unknown word, bad pattern, duplicate name or hash.
  static Result<TokenFile> from_text(std::string_view text, const std::string& name);
  /// Errors: those, kNotFound, kTooLarge (over 16 MiB).
  static Result<TokenFile> from_file(const std::string& path);

  const StaticToken* find(std::string_view token) const;  ///< Null: no such token.
  /// A token with exactly these rights.
  bool has(const Sha256& hash, const Rights& rights) const;
  std::size_t size() const { return tokens_.size(); }

 private:
  std::map<Sha256, StaticToken> tokens_;
};

/// Errors: kInternal (the system gives none).
Result<Sha256> random_bits();

struct NewStaticToken {
  std::string token;
  std::string line;
};
/// Errors: kInvalidArgument (name, patterns), kInternal (no random numbers).
Result<NewStaticToken> create_static_token(const std::string& name, const std::vector<std::string>& publish,
                                           const std::vector<std::string>& subscribe, bool admin,
                                           const std::vector<std::string>& speak = {},
                                           const std::vector<std::string>& rewind = {});

}  // namespace eigencast::broker
