// SPDX-License-Identifier: MIT
#include "broker/access/signature.h"

#include <openssl/bio.h>
#include <openssl/bn.h>
#include <openssl/crypto.h>
#include <openssl/ec.h>
#include <openssl/ecdsa.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <openssl/pem.h>

#include <algorithm>
#include <array>

#include "common/core/files.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxKeyFileBytes = 64 * 1024;
constexpr int kMinRsaBits = 2048;
constexpr std::size_t kEs256Half = 32;

struct Free {
  void operator()(BIO* p) const { BIO_free(p); }
  void operator()(EVP_MD_CTX* p) const { EVP_MD_CTX_free(p); }
  void operator()(ECDSA_SIG* p) const { ECDSA_SIG_free(p); }
};
using Bio = std::unique_ptr<BIO, Free>;
using DigestContext = std::unique_ptr<EVP_MD_CTX, Free>;
using EcdsaSignature = std::unique_ptr<ECDSA_SIG, Free>;

const unsigned char* bytes_of(std::string_view text) {
  return static_cast<const unsigned char*>(static_cast<const void*>(text.data()));
}

std::shared_ptr<EVP_PKEY> read_pem(std::string_view pem, bool private_half) {
  const Bio bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  EVP_PKEY* pair = private_half ? PEM_read_bio_PrivateKey(bio.get(), nullptr, no_passphrase, nullptr)
                                : PEM_read_bio_PUBKEY(bio.get(), nullptr, no_passphrase, nullptr);
  ERR_clear_error();
  return {pair, EVP_PKEY_free};
}

bool is_p256(const EVP_PKEY* pair) {
  std::array<char, 64> group{};
  std::size_t length = 0;
  return EVP_PKEY_get_group_name(pair, group.data(), group.size(), &length) == 1 &&
         std::string_view(group.data(), length) == "prime256v1";
}

/// Why the key does not fit the algorithm; empty: it does.
std::string misfit(const EVP_PKEY* pair, Algorithm algorithm) {
  switch (algorithm) {
    case Algorithm::kRs256:
      if (EVP_PKEY_is_a(pair, "RSA") != 1) return "RS256 needs an RSA key";
      return EVP_PKEY_get_bits(pair) < kMinRsaBits ? "an RSA key needs at least 2048 bits" : "";
    case Algorithm::kEs256:
      return EVP_PKEY_is_a(pair, "EC") == 1 && is_p256(pair) ? "" : "ES256 needs a key on the curve P-256";
    case Algorithm::kEdDsa:
      return EVP_PKEY_is_a(pair, "ED25519") == 1 ? "" : "EdDSA needs an Ed25519 key";
    case Algorithm::kHs256:
      return "HS256 needs a secret, not a key pair";
  }
  return "unknown algorithm";
}

Bytes hmac(const std::string& secret, std::string_view message) {
  Bytes out(EVP_MAX_MD_SIZE);
  unsigned int size = 0;
  HMAC(EVP_sha256(), secret.data(), static_cast<int>(secret.size()), bytes_of(message), message.size(), out.data(),
       &size);
  out.resize(size);
  return out;
}

/// JWS writes ECDSA signatures as r and s, 32 bytes each (RFC 7518, 3.4); OpenSSL as DER. Empty: not 64 bytes.
Bytes der_from_pair(ByteView pair) {
  if (pair.size() != 2 * kEs256Half) return {};
  const EcdsaSignature signature(ECDSA_SIG_new());
  BIGNUM* r = BN_bin2bn(pair.data(), kEs256Half, nullptr);
  BIGNUM* s = BN_bin2bn(pair.data() + kEs256Half, kEs256Half, nullptr);
  if (!signature || ECDSA_SIG_set0(signature.get(), r, s) != 1) {
    BN_free(r);
    BN_free(s);
    return {};
  }
  Bytes der(static_cast<std::size_t>(std::max(0, i2d_ECDSA_SIG(signature.get(), nullptr))));
  unsigned char* at = der.data();
  if (der.empty() || i2d_ECDSA_SIG(signature.get(), &at) <= 0) return {};
  return der;
}

Bytes pair_from_der(const Bytes& der) {
  const unsigned char* at = der.data();
  const EcdsaSignature signature(d2i_ECDSA_SIG(nullptr, &at, static_cast<long>(der.size())));
  Bytes pair(2 * kEs256Half);
  if (!signature || BN_bn2binpad(ECDSA_SIG_get0_r(signature.get()), pair.data(), kEs256Half) < 0 ||
      BN_bn2binpad(ECDSA_SIG_get0_s(signature.get()), pair.data() + kEs256Half, kEs256Half) < 0) {
    return {};
  }
  return pair;
}

const EVP_MD* digest_of(Algorithm algorithm) {
  return algorithm == Algorithm::kEdDsa ? nullptr : EVP_sha256();
}

}  // namespace

int no_passphrase(char*, int, int, void*) {
  return -1;
}

Result<TokenKey> TokenKey::from_secret(std::string id, std::string secret) {
  if (std::string_view(secret).find("-----BEGIN") != std::string_view::npos) {
    return fail(ErrorCode::kInvalidArgument, "a PEM file is not a secret for HS256: name its own algorithm instead");
  }
  if (secret.size() < kMinSecretBytes) {
    return fail(ErrorCode::kInvalidArgument, "an HS256 secret needs at least 32 bytes (openssl rand -base64 48)");
  }
  TokenKey key(std::move(id), Algorithm::kHs256);
  key.secret_ = std::move(secret);
  key.private_ = true;
  return key;
}

Result<TokenKey> TokenKey::from_pem(std::string id, Algorithm algorithm, std::string_view pem) {
  TokenKey key(std::move(id), algorithm);
  key.pair_ = read_pem(pem, true);
  key.private_ = key.pair_ != nullptr;
  if (!key.pair_) key.pair_ = read_pem(pem, false);
  if (!key.pair_) {
    return fail(ErrorCode::kInvalidArgument, "not a public or private key in PEM without passphrase");
  }
  if (const std::string why = misfit(key.pair_.get(), algorithm); !why.empty()) {
    return fail(ErrorCode::kInvalidArgument, why);
  }
  return key;
}

Result<TokenKey> TokenKey::from_file(std::string id, Algorithm algorithm, const std::string& path) {
  auto text = read_file(path, kMaxKeyFileBytes);
  if (!text) return text.error();
  const bool is_secret = algorithm == Algorithm::kHs256;
  while (is_secret && (text->ends_with('\n') || text->ends_with('\r'))) text->pop_back();
  auto key = is_secret ? from_secret(std::move(id), std::move(*text)) : from_pem(std::move(id), algorithm, *text);
  return key ? std::move(key) : in_context(path, key.error());
}

bool TokenKey::is_same_as(const TokenKey& other) const {
  if (id_ != other.id_ || algorithm_ != other.algorithm_ || (pair_ == nullptr) != (other.pair_ == nullptr))
    return false;
  if (pair_ != nullptr) return EVP_PKEY_eq(pair_.get(), other.pair_.get()) == 1;
  return secret_.size() == other.secret_.size() &&
         CRYPTO_memcmp(secret_.data(), other.secret_.data(), secret_.size()) == 0;
}

bool TokenKey::verifies(std::string_view message, ByteView signature) const {
  if (algorithm_ == Algorithm::kHs256) {
    const Bytes wanted = hmac(secret_, message);
    return signature.size() == wanted.size() && CRYPTO_memcmp(signature.data(), wanted.data(), wanted.size()) == 0;
  }
  Bytes der;
  if (algorithm_ == Algorithm::kEs256) {
    der = der_from_pair(signature);
    signature = der;
  }
  if (signature.empty()) return false;
  const DigestContext context(EVP_MD_CTX_new());
  const bool good =
      EVP_DigestVerifyInit(context.get(), nullptr, digest_of(algorithm_), nullptr, pair_.get()) == 1 &&
      EVP_DigestVerify(context.get(), signature.data(), signature.size(), bytes_of(message), message.size()) == 1;
  ERR_clear_error();
  return good;
}

Result<Bytes> TokenKey::sign(std::string_view message) const {
  if (!private_) {
    return fail(ErrorCode::kUnsupported, "key '" + id_ + "' is a public key, which can check tokens but not sign them");
  }
  if (algorithm_ == Algorithm::kHs256) return hmac(secret_, message);
  const DigestContext context(EVP_MD_CTX_new());
  std::size_t size = 0;
  Bytes signature;
  bool good = EVP_DigestSignInit(context.get(), nullptr, digest_of(algorithm_), nullptr, pair_.get()) == 1 &&
              EVP_DigestSign(context.get(), nullptr, &size, bytes_of(message), message.size()) == 1;
  signature.resize(good ? size : 0);
  good = good && EVP_DigestSign(context.get(), signature.data(), &size, bytes_of(message), message.size()) == 1;
  ERR_clear_error();
  signature.resize(good ? size : 0);
  if (good && algorithm_ == Algorithm::kEs256) signature = pair_from_der(signature);
  if (signature.empty()) return fail(ErrorCode::kInternal, "signing with key '" + id_ + "' failed");
  return signature;
}

}  // namespace eigencast::broker
