// SPDX-License-Identifier: MIT
#include <cstdlib>
#include <string>
#include <utility>

#include "common/core/hash/sha256.h"
#include "common/wire/limits.h"
#include "web/core/core.h"
#include "web/core/error.h"

namespace eigencast::web {
namespace {

std::string& last_error() {
  static std::string text;
  return text;
}

}  // namespace

std::int32_t failed(Error error) {
  last_error() = std::string(name_of(error.code)) + ": " + error.message;
  return -1 - static_cast<std::int32_t>(error.code);
}

}  // namespace eigencast::web

void* memory_take(uint32_t bytes) {
  return bytes <= eigencast::limits::kMaxAssetObjectBytes ? std::malloc(bytes) : nullptr;
}

void memory_give(void* taken) {
  std::free(taken);
}

const char* error_text() {
  return eigencast::web::last_error().c_str();
}

void hash_sha256(const uint8_t* bytes, uint32_t size, uint8_t* digest) {
  const eigencast::Sha256 hash = eigencast::sha256(eigencast::ByteView(bytes, size));
  std::copy(hash.digest.begin(), hash.digest.end(), digest);
}
