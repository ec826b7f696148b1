// SPDX-License-Identifier: MIT
#include <openssl/evp.h>

#include <new>

#include "common/core/hash/sha256.h"

namespace eigencast {
namespace {

EVP_MD_CTX* context_from(void* context) {
  return static_cast<EVP_MD_CTX*>(context);
}

}  // namespace

Sha256Stream::Sha256Stream()
    : context_(EVP_MD_CTX_new(), [](void* context) { EVP_MD_CTX_free(static_cast<EVP_MD_CTX*>(context)); }) {
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
