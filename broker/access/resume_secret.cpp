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
  const auto hash = [](std::string_view text) {
    return sha256({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}).hex();
  };
  return hash(hash(secret) + std::string(token));
}

}  // namespace eigencast::broker
