// SPDX-License-Identifier: MIT
#include "broker/access/resume_secret.h"

#include "broker/access/token_file.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

Result<std::string> new_resume_secret() {
  const auto bits = random_bits();
  return bits ? Result<std::string>(bits->hex()) : Result<std::string>(bits.error());
}

std::string resume_proof(std::string_view secret, std::string_view token) {
  return sha256(sha256(secret).hex() + std::string(token)).hex();
}

}  // namespace eigencast::broker
