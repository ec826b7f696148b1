// SPDX-License-Identifier: MIT
#include <openssl/crypto.h>
#include <openssl/evp.h>

#include <new>

#include "common/core/hash/sha256.h"

namespace eigencast {
namespace {

EVP_MD_CTX* context_from(void* context) {
  return static_cast<EVP_MD_CTX*>(context);
}

/// Threads that hash may end after main, as those of worker_team() do: OpenSSL then keeps what it needs to free their
/// part of it, and leaves the rest to the end of the process. The first call decides.
bool begin() {
  static const bool begun = OPENSSL_init_crypto(OPENSSL_INIT_NO_ATEXIT, nullptr) == 1;
  return begun;
}

}  // namespace

Sha256Stream::Sha256Stream()
    : context_(begin() ? EVP_MD_CTX_new() : nullptr,
               [](void* context) { EVP_MD_CTX_free(static_cast<EVP_MD_CTX*>(context)); }) {
  if (!context_ || EVP_DigestInit_ex(context_from(context_.get()), EVP_sha256(), nullptr) != 1) throw std::bad_alloc();
}

void Sha256Stream::update(ByteView data) {
  EVP_DigestUpdate(context_from(context_.get()), data.data(), data.size());
}

Sha256 Sha256Stream::finish() {
  Sha256 result;
  unsigned size = 0;
  EVP_DigestFinal_ex(context_from(context_.get()), result.digest.data(), &size);
  return result;
}

}  // namespace eigencast
