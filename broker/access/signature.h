// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "common/core/bytes.h"
#include "common/core/result.h"
#include "common/core/text.h"

struct evp_pkey_st;

namespace eigencast::broker {

/// Token signatures (RFC 7518 and RFC 8037): HMAC with SHA-256, RSA with SHA-256, ECDSA on P-256, Ed25519.
enum class Algorithm { kHs256, kRs256, kEs256, kEdDsa };

inline constexpr EnumNames<Algorithm, 4> kAlgorithms{{"HS256", "RS256", "ES256", "EdDSA"}};

/// A key and its one algorithm: the token never chooses it, so a public key cannot be passed off as an HMAC secret.
/// Immutable, cheap to copy, thread-safe.
class TokenKey {
 public:
  static constexpr std::size_t kMinSecretBytes = 32;

  /// HS256. Errors: kInvalidArgument (shorter than 32 bytes; a PEM file).
  static Result<TokenKey> from_secret(std::string id, std::string secret);
  /// RS256 (2048 bits or more), ES256, EdDSA, from a public or private key in PEM.
  /// Errors: kInvalidArgument (not a PEM key, or of another kind).
  static Result<TokenKey> from_pem(std::string id, Algorithm algorithm, std::string_view pem);
  /// Either, from a file. Errors: those above, kNotFound.
  static Result<TokenKey> from_file(std::string id, Algorithm algorithm, const std::string& path);

  const std::string& id() const { return id_; }
  Algorithm algorithm() const { return algorithm_; }
  bool can_sign() const { return private_; }
  /// Whether both have the same id, algorithm and secret or public half.
  bool is_same_as(const TokenKey& other) const;

  bool verifies(std::string_view message, ByteView signature) const;
  /// Errors: kUnsupported (a public key), kInternal.
  Result<Bytes> sign(std::string_view message) const;

 private:
  TokenKey(std::string id, Algorithm algorithm) : id_(std::move(id)), algorithm_(algorithm) {}

  std::string id_;
  Algorithm algorithm_;
  bool private_ = false;
  std::string secret_;
  std::shared_ptr<evp_pkey_st> pair_;
};

/// For OpenSSL: an encrypted PEM file must not make it ask for a passphrase on the terminal.
int no_passphrase(char* buffer, int size, int writing, void* data);

}  // namespace eigencast::broker
